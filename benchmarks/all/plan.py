"""What `python -m benchmarks all` runs, with which options, and how often. A core."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from kontur_av.errors import ConfigError

#: A figure in real time varies from run to run: its spread needs at least this many.
LIVE_RUNS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A command, and how often it runs.

    name: of its files and for `--only`. title: of its section. command: what a reader types to
    measure it again. runs: 1 where all is on virtual time, so that every run is the same.
    """

    name: str
    title: str
    command: str
    runs: int = LIVE_RUNS


_TITLES = {
    "latency": "Latency of every stream, by stage",
    "cpu": "CPU time of a session",
    "video": "Pictures through a thin channel",
    "voice": "Speech through a lossy network",
    "link": "The radio link",
    "haptics": "Stability and passivity of the hand",
    "sync": "Sight, hearing and touch, by content: virtual time",
    "sync-live": "Sight, hearing and touch, by content: live",
    "passes": "Sessions of a whole pass",
    "tasks": "Tasks in passes, by a simulated cosmonaut",
    "page": "The browser pages",
    "rtc": "The leg to a partner",
    "record": "Recordings",
}
#: Commands of measurements; all others are `python -m benchmarks` with their names.
_COMMANDS = {
    "latency": "kontur-av bench latency",
    "cpu": "kontur-av bench cpu",
    "link": "kontur-av bench link",
    "sync": "kontur-av bench sync",
    "sync-live": "kontur-av bench sync",
    "passes": "kontur-av sweep benchmarks/sweeps/passes.toml",
    "tasks": "kontur-av sweep benchmarks/sweeps/tasks.toml",
}
#: Clips that no setting was tuned on, one that was, and the contenders of the targets.
_VIDEO = " ".join(
    f"--only {name}"
    for name in (
        *("bikes", "castle", "cube", "pedestrians", "megamind", "speaker"),
        *("kontur-av", "gst-default", "gst-tuned"),
    )
)
_VIRTUAL = ("haptics", "sync", "passes", "tasks")

#: `quick` leaves out passes, which take hours; `smoke` both sweeps.
_OPTIONS: Mapping[str, Mapping[str, str]] = {
    "quick": {
        "latency": "--seconds 10 --live-seconds 10",
        "cpu": "--runs 1 --seconds 10",
        "video": f"--fetch --seconds 12 {_VIDEO}",
        "voice": "--seconds 10",
        "link": "--seconds 5",
        "haptics": "--grid small",
        "sync": "--seconds 60",
        "sync-live": "--live --seconds 15",
        "tasks": "",
        "page": "--runs 1 --seconds 8",
        "rtc": "--runs 1 --seconds 10",
        "record": "--kills 10 --cuts 500 --pairs 1 --seconds 20",
    },
    "full": {
        "latency": "--seconds 60 --live-seconds 60",
        "cpu": "--runs 1 --seconds 30",
        "video": "--fetch --seconds 20 --wide",
        "voice": "--seconds 40",
        "link": "--seconds 20",
        "haptics": "--random 300 --mode direct --mode mediated",
        "sync": "--seconds 300",
        "sync-live": "--live --seconds 60",
        "passes": "",
        "tasks": "",
        "page": "--runs 1 --seconds 30",
        "rtc": "--runs 1 --seconds 30",
        "record": "--kills 200 --cuts 0 --pairs 3 --seconds 60",
    },
    "smoke": {
        "latency": "--seconds 1 --live-seconds 5",
        "cpu": "--runs 1 --seconds 2",
        "video": "--seconds 1 --only scene --only kontur-av --only gst-default --size 320x240",
        "voice": "--seconds 1",
        "link": "--seconds 1",
        "haptics": "--cell delay=100",
        "sync": "--seconds 10",
        "sync-live": "--live --seconds 8",
        "page": "--runs 1 --seconds 2",
        "rtc": "--runs 1 --seconds 3 --only reception",
        "record": "--kills 1 --cuts 10 --pairs 1 --seconds 5",
    },
}
#: `smoke` shows that all of it works; its figures mean nothing.
LENGTHS = tuple(_OPTIONS)


def measurements(length: str, only: str | None = None) -> list[Measurement]:
    """The measurements of one of `LENGTHS`.

    only: names with commas between them; ConfigError for one that is unknown.
    """
    options = _OPTIONS[length]
    chosen = list(options) if only is None else [name.strip() for name in only.split(",")]
    for name in chosen:
        if name not in options:
            raise ConfigError(f"--only {name}: choose of {', '.join(options)}")
    return [
        Measurement(
            name=name,
            title=_TITLES[name],
            command=f"{_COMMANDS.get(name, f'python -m benchmarks {name}')} {words}".strip(),
            runs=1 if name in _VIRTUAL or length == "smoke" else LIVE_RUNS,
        )
        for name, words in options.items()
        if name in chosen
    ]


def in_turn(plan: Sequence[Measurement]) -> Iterator[tuple[Measurement, int]]:
    """(measurement, number of its run from 1): every first run, then every second one, ...

    The runs of one bench then lie minutes apart, so that a busy minute falls on one of them only.
    """
    for number in range(1, max((one.runs for one in plan), default=0) + 1):
        for measurement in plan:
            if number <= measurement.runs:
                yield measurement, number
