"""Traces of trials as MCAP files, for others to compare with or to learn from."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from mcap.writer import Writer

from benchmarks.haptics.trial import Trial, TrialPlan
from benchmarks.haptics.trial_figures import FIGURES, TrialFigures
from benchmarks.haptics.trial_run import COLUMNS, Course
from kontur_av.clock import NS_PER_MS

#: The public set: every hand, walls from soft to hard at several angles, and each kind of trouble.
TRACES = (
    "wall=500",
    "delay=50",
    "delay=100,wall=2000,hand=firm",
    "delay=100,wall=2000,hand=firm,mode=mediated",
    "delay=250,wall=1000",
    "delay=250,wall=1000,mode=mediated",
    "delay=500,wall=1000,hand=heavy",
    "delay=500,wall=1000,hand=heavy,mode=mediated",
    "delay=800,wall=500,hand=loose",
    "delay=800,wall=500,hand=loose,mode=mediated",
    "delay=100,jitter=30,loss=10,burst=5,angle=40",
    "delay=100,jitter=30,loss=20,burst=20,hand=firm,angle=-120,place=40",
    "delay=150,blackout=2",
    "delay=50,wall=800,hand=push",
    "delay=50,hand=tremor",
    "delay=100,hand=lets-go",
    "delay=100,hand=limp,angle=90,place=50",
    "delay=100,wall=2000,hand=pulls-back",
    "delay=200,loss=5,wall=300,hand=reflex",
    "delay=50,restart=both",
)
TOPIC = "/trial"


def schema() -> bytes:
    """The JSON schema of a millisecond, with the unit of each value."""
    properties = {
        name: {"type": "number", "unit": unit, "description": f"{text}, {unit}".strip(", ")}
        for name, (unit, text) in COLUMNS.items()
    }
    return json.dumps({"title": "Trial", "type": "object", "properties": properties}).encode()


def write_trace(
    directory: Path,
    planned: TrialPlan,
    course: Course,
    figures: TrialFigures,
    *,
    seed: int,
    controllers: Sequence[str],
) -> Path:
    """Write a run as `NAME.mcap` into `directory`; return the file. It is the same every time."""
    trial: Trial = figures.trial
    path = directory / f"{trial.name}.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="kontur-av benchmarks haptics")
        of = {**asdict(trial), "channel": trial.channel, "seed": seed}
        of["joystick_controller"], of["robot_controller"] = controllers
        writer.add_metadata("trial", {name: str(value) for name, value in of.items()})
        found = {name: str(getattr(figures, name)) for name in FIGURES}
        writer.add_metadata("figures", found)
        phases = {str(number): phase for number, phase in enumerate(planned.phases)}
        writer.add_metadata("phase of each waypoint", phases)
        kind = writer.register_schema("Trial", "jsonschema", schema())
        channel = writer.register_channel(TOPIC, "json", kind)
        for number, row in enumerate(course.tolist()):
            # Eight digits tell more than any sensor.
            values = (None if value != value else float(f"{value:.8g}") for value in row)
            data = json.dumps(dict(zip(COLUMNS, values, strict=True)), separators=(",", ":"))
            at_ns = number * NS_PER_MS
            writer.add_message(channel, at_ns, data.encode(), at_ns)
        writer.finish()
    return path
