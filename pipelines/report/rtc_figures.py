"""What the leg to a partner reports, for the report and for the live view. A core."""

from kontur_av.clock import NS_PER_MS
from pipelines.media.figures import DisplayFigures
from pipelines.partner.figures import RtcFigures
from pipelines.report.collector import Collector
from pipelines.report.model import RtcReport, RtcShownReport
from pipelines.report.spread import spread_ms
from pipelines.session.topology import RTC, RTC_CAMERA, RTC_DISPLAY, RTC_VOICE


def rtc_report(collector: Collector, seconds: float) -> RtcReport | None:
    """The leg of a session of `seconds`; None without one."""
    if collector.topology.setup.rtc is None:
        return None
    figures = collector.process(RTC).find(RtcFigures)
    if figures is None:
        return None
    return RtcReport(
        figures=figures,
        mean_bps={
            name: round(8 * stream.octets / max(seconds, 1e-9))
            for name, stream in sorted(figures.streams.items())
        },
        shown={
            name: RtcShownReport(
                display=collector.process(RTC_DISPLAY).total(DisplayFigures, name),
                latency_ms=spread_ms(collector.partner[name]),
            )
            for name in (RTC_CAMERA, RTC_VOICE)
        },
    )


def rtc_now(collector: Collector, now_ns: int) -> dict[str, int | float | str | None]:
    """The partner as the pages of the ground show it; empty without a leg."""
    leg = collector.topology.setup.rtc
    if leg is None:
        return {}
    told = collector.process(RTC).total(RtcFigures)
    trip_ns = told.round_trip_ns
    found: dict[str, int | float | str | None] = {
        "rtc.partners": told.partners,
        "rtc.route": told.route,
        "rtc.round_trip_ms": None if trip_ns is None else round(trip_ns / NS_PER_MS, 3),
        "rtc.rate_bps": told.rate_bps or None,
    }
    display = collector.process(RTC_DISPLAY)
    for name in (RTC_CAMERA, RTC_VOICE):
        shown = display.total(DisplayFigures, name)
        age_ns = None if shown.age_ns is None else shown.age_ns + max(0, now_ns - display.told_ns)
        found[f"{name}.age_ms"] = None if age_ns is None else round(age_ns / NS_PER_MS, 1)
        found[f"{name}.displayed"] = shown.frames_displayed
    return found


def rtc_line(collector: Collector) -> str | None:
    """A line for the live view; None without a leg or a partner."""
    told = collector.process(RTC).total(RtcFigures)
    if not told.partners:
        return None
    trip_ns = told.round_trip_ns
    trip = "" if trip_ns is None else f", round trip {trip_ns / NS_PER_MS:.0f} ms"
    route = "" if told.route is None else f" by {told.route}"
    rate = f"{told.rate_bps / 1000:g} kbit/s"
    return f"partner: {told.partners} connections{route}{trip}, picture at {rate}"
