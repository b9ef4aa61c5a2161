"""Traces of runs as MCAP files, for others to compare with or to learn from."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from mcap.writer import Writer

from benchmarks.haptics.haptics_metrics import SUMMED, CellMetrics
from benchmarks.haptics.plan import CellPlan
from benchmarks.haptics.run import COLUMNS, SCHEMA, Course
from kontur_av.clock import NS_PER_MS

TOPIC = "/hand"


def write_trace(
    directory: Path,
    planned: CellPlan,
    course: Course,
    metrics: CellMetrics,
    *,
    seed: int,
    controllers: Sequence[str],
) -> Path:
    """Write a run as `NAME.mcap` into `directory`; return the file. It is the same every time."""
    cell = metrics.cell
    path = directory / f"{cell.name}.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="kontur-av benchmarks haptics")
        of = {**asdict(cell), "seed": seed}
        of["joystick_controller"], of["robot_controller"] = controllers
        writer.add_metadata("cell", {name: str(value) for name, value in of.items()})
        found = {name: str(getattr(metrics, name)) for name in SUMMED}
        writer.add_metadata("figures", found)
        phases = {str(number): phase for number, phase in enumerate(planned.phases)}
        writer.add_metadata("phases", phases)
        kind = writer.register_schema("Hand", "jsonschema", SCHEMA.encode())
        channel = writer.register_channel(TOPIC, "json", kind)
        for number, row in enumerate(course.tolist()):
            # Eight digits tell more than any sensor.
            values = (None if value != value else float(f"{value:.8g}") for value in row)
            data = json.dumps(dict(zip(COLUMNS, values, strict=True)), separators=(",", ":"))
            at_ns = number * NS_PER_MS
            writer.add_message(channel, at_ns, data.encode(), at_ns)
        writer.finish()
    return path
