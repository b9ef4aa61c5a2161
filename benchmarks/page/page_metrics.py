"""Figures of the browser pages, and their targets. A core."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isnan
from statistics import median

from pipelines.report.result import Headline, Percentiles

OURS, PEER = "page", "aiortc to <video>"
#: What else runs on the machine: only the page and its server, or a session with all its processes.
ALONE, LIVE = "page alone", "beside a live session"

#: By the number of views: p50 and p99 from the topic to the pixel, in ms.
_VIEW_TARGETS_MS = {1: (8.0, 20.0), 3: (None, 35.0)}
_JOIN_TARGET_MS = 600.0
_POINTER_TARGET_MS = 6.0
_IDLE_TARGET, _WATCHED_TARGET = 0.01, 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewRun:
    """One run of one contender.

    pixel_ms: from publication until the number is in the framebuffer. published, seen: pictures.
    join_ms: from opening the address to the first live picture, of each view; only of the page.
    server_cpu: share of a core that the page's process took; only of the page.
    """

    who: str
    views: int
    pixel_ms: Percentiles
    published: int
    seen: int
    join_ms: list[float] = field(default_factory=list)
    server_cpu: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRun:
    """A live session. page: how its pages are (`benchmarks.page.session.PAGES`).

    page_cpu: share of a core of the operator's page process; None without pages.
    session_cpu: cores that the whole session took.
    video_p50_ms, video_p99_ms: the uplink picture, capture to display.
    slot_p99_us: lateness of the ground gateway's slots.
    """

    page: str
    page_cpu: float | None
    session_cpu: float
    video_p50_ms: float
    video_p99_ms: float
    slot_p99_us: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayRun:
    """Delays of a run. where: ALONE or LIVE."""

    where: str
    delay_ms: Percentiles


@dataclass(frozen=True, slots=True, kw_only=True)
class HeapSample:
    """A page after a garbage collection. at_s: since it was opened."""

    at_s: float
    heap_octets: int
    nodes: int
    listeners: int


@dataclass(frozen=True, slots=True, kw_only=True)
class HeapRun:
    """A seat ("space" or "ground") that stays open."""

    seat: str
    samples: list[HeapSample]


@dataclass(frozen=True, slots=True, kw_only=True)
class PageResult:
    """All runs.

    pointer: from the pointer's event to the hand in its topic.
    voice: from ground control's microphone to the worklet of the operator's page.
    """

    views: tuple[ViewRun, ...] = ()
    sessions: tuple[SessionRun, ...] = ()
    pointer: tuple[DelayRun, ...] = ()
    voice: tuple[DelayRun, ...] = ()
    heaps: tuple[HeapRun, ...] = ()


def headlines(result: PageResult) -> list[Headline]:
    """Medians over the runs."""
    found = []
    for who, views in dict.fromkeys((run.who, run.views) for run in result.views):
        runs = [run for run in result.views if (run.who, run.views) == (who, views)]
        p50_ms, p99_ms = _VIEW_TARGETS_MS.get(views, (None, None)) if who == OURS else (None, None)
        group = f"{views} view{'s' * (views > 1)} of 640x480"
        for name, target_ms in (("p50", p50_ms), ("p95", None), ("p99", p99_ms)):
            value = _middle([getattr(run.pixel_ms, name) for run in runs])
            found.append(_headline(group, f"topic to pixel, {name}", who, "ms", value, target_ms))
        joins = [join_ms for run in runs for join_ms in run.join_ms]
        if joins:
            value = _middle(joins)
            found.append(
                _headline(
                    group, "address opened to live picture", who, "ms", value, _JOIN_TARGET_MS
                )
            )
        cpus = [run.server_cpu for run in runs if run.server_cpu is not None]
        if cpus and views == 1:
            value = _middle(cpus)
            found.append(
                _headline(group, "the page's server", who, "cores", value, _WATCHED_TARGET)
            )
    for what, delays, target_ms in (
        ("pointer to the joystick's topic", result.pointer, _POINTER_TARGET_MS),
        ("microphone to the other page's worklet", result.voice, None),
    ):
        for where in dict.fromkeys(run.where for run in delays):
            for name in ("p50", "p99"):
                value = _middle(
                    [getattr(run.delay_ms, name) for run in delays if run.where == where]
                )
                most_ms = target_ms if (name, where) == ("p99", ALONE) else None
                found.append(
                    _headline("hand and voice", f"{what}, {name}", where, "ms", value, most_ms)
                )
    for page in dict.fromkeys(run.page for run in result.sessions):
        sessions = [run for run in result.sessions if run.page == page]
        cpus = [run.page_cpu for run in sessions if run.page_cpu is not None]
        target = {"nobody looks": _IDLE_TARGET, "one reader": _WATCHED_TARGET}.get(page)
        group = "live session, beside its pages"
        if cpus:
            value = _middle(cpus)
            found.append(
                _headline(group, "the operator's page process", page, "cores", value, target)
            )
        for what, unit, name in (
            ("all processes", "cores", "session_cpu"),
            ("uplink_video, capture to display, p50", "ms", "video_p50_ms"),
            ("uplink_video, capture to display, p99", "ms", "video_p99_ms"),
            ("lateness of slots, p99", "µs", "slot_p99_us"),
        ):
            value = _middle([getattr(run, name) for run in sessions])
            found.append(_headline(group, what, page, unit, value, None))
    for heap in result.heaps:
        first, last = heap.samples[0], heap.samples[-1]
        group = f"/{heap.seat} open for {last.at_s / 60:.3g} min, after {first.at_s / 60:.2g} min"
        for what, unit, name, per in (
            ("heap", "MB", "heap_octets", 1e6),
            ("nodes", "", "nodes", 1),
            ("listeners", "", "listeners", 1),
        ):
            for when, sample in (("first", first), ("last", last)):
                value = getattr(sample, name) / per
                found.append(_headline(group, f"{what}, {when}", OURS, unit, value, None))
    return found


def _headline(
    group: str, what: str, who: str, unit: str, value: float | None, target: float | None
) -> Headline:
    return Headline(
        group=group,
        what=what,
        who=who,
        unit=unit,
        value=value,
        target="" if target is None else f"≤ {target:g}",
        met=None if target is None or value is None else value <= target,
    )


def _middle(values: Sequence[float]) -> float | None:
    known = [value for value in values if not isnan(value)]
    return median(known) if known else None
