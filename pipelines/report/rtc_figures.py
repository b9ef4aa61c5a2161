"""What the leg to a partner reports, for the report and for the live view. A core."""

from kontur_av.clock import NS_PER_MS
from pipelines.report.collector import Collector
from pipelines.report.model import RtcReport, RtcShownReport, RtcStreamReport
from pipelines.report.spread import spread_ms
from pipelines.session.figures import DisplayCounters, DisplayGauges, RtcCounters, RtcGauges
from pipelines.session.topology import RTC, RTC_CAMERA, RTC_DISPLAY, RTC_VOICE


def rtc_report(collector: Collector, seconds: float) -> RtcReport | None:
    """The leg of a session of `seconds`; None without one."""
    if collector.topology.setup.rtc is None:
        return None
    figures = collector.process(RTC)
    counters, gauges = figures.counted(RtcCounters), figures.gauges(RtcGauges)
    if counters is None or gauges is None:
        return None
    return RtcReport(
        connections=counters.connections,
        ice_restarts=counters.ice_restarts,
        route=gauges.route,
        round_trip_ms=_trip_ms(gauges),
        rate_bps=gauges.rate_bps,
        rate_lowered=counters.rate_lowered,
        garbage=counters.garbage,
        refused=sum(counters.refused.values()),
        samples=dict(counters.samples),
        streams={name: _stream(name, counters, seconds) for name in sorted(counters.packets)},
        shown={name: _shown(name, collector) for name in (RTC_CAMERA, RTC_VOICE)},
    )


def _shown(name: str, collector: Collector) -> RtcShownReport:
    counters = collector.process(RTC_DISPLAY).total(DisplayCounters, name)
    return RtcShownReport(
        displayed=counters.frames_displayed,
        damaged_ms=round(counters.damaged_ns / NS_PER_MS, 3),
        latency_ms=spread_ms(collector.partner[name]),
    )


def rtc_now(collector: Collector, now_ns: int) -> dict[str, int | float | str | None]:
    """The partner as the pages of the ground show it; empty without a leg."""
    leg = collector.topology.setup.rtc
    if leg is None:
        return {}
    gauges = collector.process(RTC).gauges(RtcGauges)
    found: dict[str, int | float | str | None] = {
        "rtc.partners": 0 if gauges is None else gauges.partners,
        "rtc.route": None if gauges is None else gauges.route,
        "rtc.round_trip_ms": None if gauges is None else _trip_ms(gauges),
        "rtc.rate_bps": None if gauges is None else gauges.rate_bps,
    }
    display = collector.process(RTC_DISPLAY)
    for name in (RTC_CAMERA, RTC_VOICE):
        shown = display.gauges(DisplayGauges, name)
        age_ns = None if shown is None else shown.age_ns + max(0, now_ns - display.told_ns)
        found[f"{name}.age_ms"] = None if age_ns is None else round(age_ns / NS_PER_MS, 1)
        found[f"{name}.displayed"] = display.total(DisplayCounters, name).frames_displayed
    return found


def _trip_ms(gauges: RtcGauges) -> float | None:
    trip_ns = gauges.round_trip_ns
    return None if trip_ns is None else round(trip_ns / NS_PER_MS, 3)


def _stream(name: str, counters: RtcCounters, seconds: float) -> RtcStreamReport:
    return RtcStreamReport(
        packets=counters.packets[name],
        mean_bps=round(8 * counters.octets.get(name, 0) / max(seconds, 1e-9)),
        lost=counters.packets_lost.get(name, 0),
        asked=counters.packets_asked.get(name, 0),
        repeated=counters.packets_repeated.get(name, 0),
        keys_asked=counters.keys_asked.get(name, 0),
    )


def rtc_line(collector: Collector) -> str | None:
    """A line for the live view; None without a leg or a partner."""
    gauges = collector.process(RTC).gauges(RtcGauges)
    if gauges is None or not gauges.partners:
        return None
    trip_ns = gauges.round_trip_ns
    trip = "" if trip_ns is None else f", round trip {trip_ns / NS_PER_MS:.0f} ms"
    route = "" if gauges.route is None else f" by {gauges.route}"
    rate = f"{gauges.rate_bps / 1000:g} kbit/s"
    return f"partner: {gauges.partners} connections{route}{trip}, picture at {rate}"
