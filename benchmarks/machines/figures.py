"""A session on two machines beside the same on one. A core."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median

from kontur_av.clock import NS_PER_MS
from pipelines.report.result import Headline, JsonReader

#: A latency on two machines may differ by this much from that on one.
SAME_WITHIN_MS = 3.0
PERCENTILES = ("p50", "p99")
_DIRECTIONS = {"up": "force", "down": "motion"}


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamFigures:
    """A media stream. over_cap_bps: by how much a second was over its cap; 0 for none."""

    latency_ms: dict[str, float]
    packets: int
    lost: int
    over_cap_bps: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionFigures:
    """One session. haptic_ms: one-way delay of the samples, by direction, up and down.

    clock_offset_ms: of space, as the ground knew it in the end; latency_error_ms: as the joined
    report states it; both None on one machine. failures: those of the report.
    """

    streams: dict[str, StreamFigures]
    haptic_ms: dict[str, dict[str, float]]
    samples_lost: dict[str, int]
    clock_offset_ms: float | None
    latency_error_ms: float | None
    failures: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MachinesResult:
    """Sessions on one machine, and as many on two, in turn."""

    setup: str
    seconds: float
    delay_ms: float
    hosts: str
    one: tuple[SessionFigures, ...]
    two: tuple[SessionFigures, ...]


def read_session(report: JsonReader) -> SessionFigures:
    """The figures of a session's report. ValueError if it is no report of a session."""
    streams = {
        name: StreamFigures(
            latency_ms={each: row.number("latency_ms", each) for each in PERCENTILES},
            packets=row.count("rtp_packets"),
            lost=row.count("rtp_lost"),
            over_cap_bps=max(
                0,
                row.count("payload_bps_max_1s")
                - row.count("cap_bps")
                - round(row.number_or_none("gained_bps") or 0),
            ),
        )
        for name, row in report.items("streams")
    }
    known = report.has("gateways", "ground", "clock", "offset_ns")
    errors = [row.number_or_none("latency_error_ms") for _, row in report.items("streams")]
    return SessionFigures(
        streams=streams,
        haptic_ms={
            key: {each: report.number("haptic", key, "latency_ms", each) for each in PERCENTILES}
            for key in _DIRECTIONS
        },
        samples_lost={key: report.count("haptic", key, "lost") for key in _DIRECTIONS},
        clock_offset_ms=report.number("gateways", "ground", "clock", "offset_ns") / NS_PER_MS
        if known
        else None,
        latency_error_ms=max((one for one in errors if one is not None), default=None),
        failures=tuple(str(each.value) for each in report.elements("failures")),
    )


def headlines(result: MachinesResult) -> list[Headline]:
    """Medians over the sessions."""
    found: list[Headline] = []
    names = list(result.one[0].streams) if result.one else []
    for name in names:
        for each in PERCENTILES:
            found += _compared(
                f"{name}, capture to display, {each}",
                [run.streams[name].latency_ms[each] for run in result.one],
                [run.streams[name].latency_ms[each] for run in result.two],
            )
    for key, what in _DIRECTIONS.items():
        for each in PERCENTILES:
            found += _compared(
                f"{what}, one way, {each}",
                [run.haptic_ms[key][each] for run in result.one],
                [run.haptic_ms[key][each] for run in result.two],
            )
    for who, runs in (("one machine", result.one), ("two machines", result.two)):
        found += _counted(who, runs)
    errors = [run.latency_error_ms for run in result.two if run.latency_error_ms is not None]
    offsets = [abs(run.clock_offset_ms) for run in result.two if run.clock_offset_ms is not None]
    for what, values in (
        ("error of latencies between the clocks, as stated", errors),
        ("offset of the clock, as estimated (in truth 0)", offsets),
    ):
        if values:
            found.append(Headline(what=what, who="two machines", unit="ms", value=median(values)))
    return found


def _compared(what: str, one: Sequence[float], two: Sequence[float]) -> Iterator[Headline]:
    yield Headline(what=what, who="one machine", unit="ms", value=median(one))
    yield Headline(what=what, who="two machines", unit="ms", value=median(two))
    more = median(two) - median(one)
    yield Headline(
        what=what,
        who="difference",
        unit="ms",
        value=more,
        target=f"within {SAME_WITHIN_MS:g} ms",
        met=abs(more) <= SAME_WITHIN_MS,
    )


def _counted(who: str, runs: Sequence[SessionFigures]) -> Iterator[Headline]:
    rows = [row for run in runs for row in run.streams.values()]
    lost, over = sum(row.lost for row in rows), max(row.over_cap_bps for row in rows)
    yield Headline(what="RTP packets lost", who=who, unit="", value=lost, target="0", met=lost == 0)
    yield Headline(
        what="payload over a cap, any second",
        who=who,
        unit="bit/s",
        value=over,
        target="0",
        met=over == 0,
    )
