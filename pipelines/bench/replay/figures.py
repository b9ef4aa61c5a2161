"""What a link changes of a recorded session: reports of its replays, side by side. A core."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from pipelines.bench.result import Headline
from pipelines.report.model import SessionReport, Spread
from pipelines.session.setup.table import NO_RADIO

#: The case whose pictures must be those of the recording.
SAME = "as recorded"


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A replay. name: of its column. report: of the simulation."""

    name: str
    report: SessionReport


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayResult:
    """All of them. setup: its name. seconds: of the recording. cases: `SAME` first."""

    setup: str
    seconds: float
    cases: tuple[Case, ...]

    @property
    def sound(self) -> bool:
        """Whether the same link gave the same pictures. On others a stream may well fail.

        A radio that loses frames by chance need not lose the same ones again, so it is not judged.
        """
        met = [one.met for one in headlines(self)]
        return False not in met and not self.cases[0].report.failures


def headlines(result: ReplayResult) -> list[Headline]:
    """The figures for the page of measurements."""
    group = f"{result.setup}, {result.seconds:.0f} s"
    found = []
    same = result.cases[0].report.simulation
    exact = same is not None and same.radio == NO_RADIO
    for case in result.cases:
        for what, unit, value, target in _figures(case.report):
            judged = exact and target is not None and case.name == SAME
            found.append(
                Headline(
                    group=group,
                    what=what,
                    who=case.name,
                    unit=unit,
                    value=value,
                    target=f"{target:g} {unit}" if judged else "",
                    met=value == target if judged else None,
                )
            )
    return found


#: What, its unit, its value, and what it must be on the link of the recording.
_Figure = tuple[str, str, float | None, float | None]


def _figures(report: SessionReport) -> Iterator[_Figure]:
    assert report.replay is not None
    for name in report.streams:
        if name in report.replay.streams:
            yield from _pictures(name, report)
        else:
            yield from _sound(name, report)
    for key, what in (("up", "force"), ("down", "motion")):
        samples = report.haptic[key]
        yield from _latency(f"{what}, one way", samples.latency_ms)
        yield (
            f"{what}, samples lost",
            "%",
            _percent(samples.receiver.lost, samples.sender.sent),
            None,
        )


def _pictures(name: str, report: SessionReport) -> Iterator[_Figure]:
    assert report.replay is not None
    replayed, shown = report.replay.streams[name], report.streams[name]
    recorded = replayed.units_recorded
    for what, part, whole, target in (
        ("access units that came whole", replayed.units_received, recorded, None),
        (
            "of those that came then, octet by octet",
            replayed.same_received,
            replayed.recorded_received,
            100.0,
        ),
        ("pictures equal to those sent", replayed.pictures_same, recorded, 100.0),
    ):
        value = None if report.replay.recoded else _percent(part, whole)
        yield f"{name}, {what}", "%", value, target
    yield f"{name}, PSNR against those sent, mean", "dB", replayed.psnr_db_mean, None
    yield f"{name}, PSNR, worst 5 %", "dB", replayed.psnr_db_p5, None
    yield f"{name}, displayed", "pictures/s", shown.display.frames_displayed / report.seconds, None
    yield from _latency(f"{name}, capture to display", shown.latency_ms)
    for what, value_ns in (
        ("frozen", shown.display.frozen_ns),
        ("damaged", shown.display.damaged_ns),
    ):
        displayed = shown.display.frames_displayed
        share = value_ns / NS_PER_S / report.seconds * 100 if displayed else None
        yield f"{name}, {what}", "% of time", share, None


def _sound(name: str, report: SessionReport) -> Iterator[_Figure]:
    heard = report.streams[name]
    yield f"{name}, packets lost", "%", _percent(heard.rtp.rtp_lost, heard.rtp.rtp_packets), None
    yield from _latency(f"{name}, mouth to ear", heard.latency_ms)


def _latency(what: str, spread: Spread) -> Iterator[_Figure]:
    for share, value in (("p50", spread.p50), ("p99", spread.p99)):
        yield f"{what}, {share}", "ms", value if spread.count else None, None


def _percent(part: int | None, whole: int | None) -> float | None:
    return None if part is None or not whole else 100 * part / whole


def rows(found: Sequence[Headline]) -> list[tuple[str, ...]]:
    """A row for each figure: what, unit, and a value for each case."""
    names = list(dict.fromkeys(one.who for one in found))
    values = {(one.what, one.unit, one.who): one.value for one in found}
    return [
        (what, unit, *(_text(values.get((what, unit, name))) for name in names))
        for what, unit in dict.fromkeys((one.what, one.unit) for one in found)
    ]


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
