"""Figures of the leg to a partner. A core."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isnan
from statistics import median

from pipelines.report.result import Headline, Percentiles

OURS, PEER = "kontur-av", "plain aiortc"
#: How the leg is while the session runs. `full`: its network carries a third of the picture's rate.
#: `cut`: from the middle on its network carries nothing.
NO_LEG, IDLE, BUSY, FULL, CUT = "no leg", "nobody there", "partner there", "network full", "cut"
LEGS = (NO_LEG, IDLE, BUSY, FULL, CUT)


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelRun:
    """From the capture to a browser's framebuffer.

    round_trip_ms: of the network, as reports told it; None if none came.
    """

    pixel_ms: Percentiles
    captured: int
    seen: int
    round_trip_ms: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceptionRun:
    """From sending coded media to decoded ones. who: OURS or PEER."""

    who: str
    picture_ms: Percentiles
    voice_ms: Percentiles
    pictures: int
    clicks: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRun:
    """A live session. leg: one of LEGS.

    latency_ms: by stream, capture to display. force_ms: haptic samples to space.
    slot_us: lateness of the ground gateway's slots. lost: RTP packets over the radio.
    partner_bps, partner_lost: of the picture for the partner; None without a leg.
    """

    leg: str
    latency_ms: dict[str, dict[str, float]]
    force_ms: dict[str, float]
    slot_us: float
    lost: int
    cores: float
    partner_bps: int | None
    partner_lost: int | None
    failures: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RtcResult:
    """All runs."""

    pixels: tuple[PixelRun, ...] = ()
    receptions: tuple[ReceptionRun, ...] = ()
    sessions: tuple[SessionRun, ...] = ()
    #: Why some were not measured; "" if all were.
    lacking: str = ""


def headlines(result: RtcResult) -> list[Headline]:
    """Medians over the runs."""
    return [*_pixel_lines(result), *_reception_lines(result), *_session_lines(result)]


def _pixel_lines(result: RtcResult) -> list[Headline]:
    if not result.pixels:
        return []
    group = "to a browser, 640x480 at 30 Hz"
    found = [
        Headline(
            group=group,
            what=f"capture to pixel, {each}",
            who="partner's page",
            unit="ms",
            value=_median([getattr(run.pixel_ms, each) for run in result.pixels]),
        )
        for each in ("p50", "p95", "p99")
    ]
    trips = [run.round_trip_ms for run in result.pixels if run.round_trip_ms is not None]
    found.append(
        Headline(
            group=group,
            what="round trip of the network and of reports",
            who="partner's page",
            unit="ms",
            value=_median(trips),
        )
    )
    return found


def _reception_lines(result: RtcResult) -> list[Headline]:
    found = []
    for who in (OURS, PEER):
        runs = [run for run in result.receptions if run.who == who]
        for kind in ("picture", "voice"):
            for each in ("p50", "p95", "p99"):
                values = [getattr(getattr(run, f"{kind}_ms"), each) for run in runs]
                found.append(
                    Headline(
                        group="from a partner",
                        what=f"{kind}, sent to decoded, {each}",
                        who=who,
                        unit="ms",
                        value=_median(values),
                    )
                )
    return found if result.receptions else []


def _session_lines(result: RtcResult) -> list[Headline]:
    rows: list[tuple[str, str, Callable[[SessionRun], float | None]]] = [
        (f"{stream}, capture to display, {each}", "ms", _latency(stream, each))
        for stream in ("uplink_video", "uplink_voice", "downlink_video")
        for each in ("p50", "p99")
    ]
    rows += [
        ("force, one way, p99", "ms", lambda run: run.force_ms["p99"]),
        ("lateness of slots, p99", "µs", lambda run: run.slot_us),
        ("RTP packets lost over the radio", "", lambda run: run.lost),
        ("all processes", "cores", lambda run: run.cores),
        ("picture to the partner", "kbit/s", lambda run: _kilo(run.partner_bps)),
        ("its packets that were lost", "", lambda run: run.partner_lost),
    ]
    found = []
    for what, unit, read in rows:
        for leg in LEGS:
            values = [read(run) for run in result.sessions if run.leg == leg]
            known = [value for value in values if value is not None]
            if known:
                radio = what.startswith("RTP packets")
                value = sum(known) if radio else _median(known)
                found.append(
                    Headline(
                        group="the radio link beside the leg to a partner",
                        what=what,
                        who=leg,
                        unit=unit,
                        value=value,
                        target="0" if radio else "",
                        met=value == 0 if radio else None,
                    )
                )
    return found


def _latency(stream: str, each: str) -> Callable[[SessionRun], float | None]:
    return lambda run: run.latency_ms.get(stream, {}).get(each)


def _kilo(bps: int | None) -> float | None:
    return None if bps is None else bps / 1000


def _median(values: Sequence[float]) -> float | None:
    known = [value for value in values if not isnan(value)]
    return median(known) if known else None
