"""The figures of a running session by name, for pages, recordings and Foxglove. A core.

A figure has the name that its key has in the report, without `streams.`: `uplink_video.cap_bps`.
These have none there:

| figure | what |
|---|---|
| STREAM.`age_ms` | how old what is shown is |
| `skew_limits_ms.`NAME`.least`, `.most` | what people do not notice |
| `hand.holder` | the page that holds the handle |
| `recorder.file`, `.lost` | null while nothing is recorded; messages that are not in the files |
| `rtc.round_trip_ms`, `rtc_camera.age_ms`, `.displayed` | the leg to a partner, its pictures |
| `tmtc.`END`.`COUNT | telecommands, telemetry and K2ACI of an end (`TmtcMetrics`) |
| `contact.since_acquisition_s`, `contact.until_loss_s` | the present instant in the pass |
| `contact.ahead`, `contact.ahead_s` | what the pass brings next, and in how long |
| `upkeep.experiment`, `upkeep.short` | what runs; where bandwidth is short; null for nothing |
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from kontur_av.clock import NS_PER_MS
from pipelines.media.media_metrics import DisplayMetrics
from pipelines.mission.mission_metrics import TmtcMetrics
from pipelines.partner.partner_metrics import RtcMetrics
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.report.collector import Collector
from pipelines.report.sync_metrics import LIMITS
from pipelines.report.upkeep_now import UpkeepNow
from pipelines.seats.page_metrics import HOLDER, PageMetrics
from pipelines.session.session_metrics import Figure
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.topics import (
    PAGES,
    RECORDER,
    RTC,
    RTC_CAMERA,
    RTC_DISPLAY,
    RTC_VOICE,
)

#: The tables of the report whose figures are told.
_TABLES = ("haptic", "skew_ms", "joystick", "link", "gateways", "cpu", "processes")
#: What is not told, because it never changes.
_LEFT_OUT = {"needed_at_caps_bps"}
#: By end: the process that has its telecommands and telemetry.
_TMTC_ENDS = {"space": "console", "ground": "selector"}
_PERCENTILES = ("p50", "p95", "p99", "p99.9", "max", "mean")


def figures_of(
    tables: Mapping[str, Any],
    collector: Collector,
    upkeep: UpkeepNow,
    *,
    pass_s: float,
    now_ns: int,
) -> dict[str, Figure]:
    """Return all figures. tables: the report of `now_ns` as JSON has it. pass_s: in the pass."""
    found: dict[str, Figure] = {}
    for name, stream in tables["streams"].items():
        found |= _flat(name, stream)
        found[f"{name}.age_ms"] = _ms(stream.get("age_ns"))
    for name in _TABLES:
        found |= _flat(name, tables[name])
    for name, limits in LIMITS.items():
        found[f"skew_limits_ms.{name}.least"] = limits.least_ns / NS_PER_MS
        found[f"skew_limits_ms.{name}.most"] = limits.most_ns / NS_PER_MS
    seat = collector.process(PAGES[Segment.SPACE]).total(PageMetrics)
    found[HOLDER] = seat.holder or None
    for segment, process in _TMTC_ENDS.items():
        found |= _flat(f"tmtc.{segment}", asdict(collector.process(process).total(TmtcMetrics)))
    found |= dict(_recorded(collector.process(RECORDER).find(RecorderMetrics)))
    if collector.setup.rtc is not None:
        found |= dict(_partner(collector, now_ns))
    contact = next(iter(tables["gateways"].values())).get("radio") or {}
    if windows := contact.get("contact"):
        found["contact.since_acquisition_s"] = round(pass_s - windows["acquisition_s"], 1)
        found["contact.until_loss_s"] = round(windows["loss_s"] - pass_s, 1)
    what, left_s = upkeep.next or (None, None)
    return found | {
        "contact.ahead": what,
        "contact.ahead_s": None if left_s is None else round(left_s, 1),
        "upkeep.experiment": upkeep.experiment or None,
        "upkeep.short": upkeep.short or None,
    }


def _recorded(recorder: RecorderMetrics | None) -> Iterator[tuple[str, Figure]]:
    if recorder is not None:
        file = (recorder.file or "").rpartition("/")[2]
        yield "recorder.file", file if recorder.recording else None
        yield "recorder.octets", recorder.octets
        yield "recorder.lost", recorder.lost
        yield "recorder.fault", recorder.fault


def _partner(collector: Collector, now_ns: int) -> Iterator[tuple[str, Figure]]:
    leg, display = collector.process(RTC).total(RtcMetrics), collector.process(RTC_DISPLAY)
    yield "rtc.partners", leg.partners
    yield "rtc.route", leg.route
    yield "rtc.round_trip_ms", _ms(leg.round_trip_ns, 3)
    yield "rtc.rate_bps", leg.rate_bps or None
    for name in (RTC_CAMERA, RTC_VOICE):
        shown = display.total(DisplayMetrics, name)
        age_ns = None if shown.age_ns is None else shown.age_ns + max(0, now_ns - display.told_ns)
        yield f"{name}.age_ms", _ms(age_ns)
        yield f"{name}.displayed", shown.frames_displayed


def _ms(value_ns: int | None, digits: int = 1) -> float | None:
    return None if value_ns is None else round(value_ns / NS_PER_MS, digits)


def _flat(prefix: str, value: Any) -> dict[str, Figure]:
    """Names and values of all but lists. Percentiles of nothing have no value."""
    if not isinstance(value, dict):
        return {} if isinstance(value, list | tuple) else {prefix: value}
    found: dict[str, Figure] = {}
    empty = value.get("count") == 0
    for key, below in value.items():
        if key not in _LEFT_OUT:
            known = None if empty and key in _PERCENTILES else below
            found |= _flat(f"{prefix}.{key}", known)
    return found
