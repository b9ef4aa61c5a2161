"""One report for every run: what each stream got, as plain values for JSON."""

from collections.abc import Mapping
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from pipelines.cores.haptics import PORT_GAUGES, PORT_TOTALS
from pipelines.report.ages import spells
from pipelines.report.collector import HAPTIC_ENDS, Collector, ProcessFigures, StreamFigures
from pipelines.report.link_figures import gateway_figures, link_figures, summary_us
from pipelines.report.pauses import Pauses
from pipelines.report.silence import MISSED_NS, missed_ns, signal_ns, silences, stopped_ns
from pipelines.report.sync.figures import disagreements
from pipelines.report.sync.section import sync_section
from pipelines.report.terms import video_lead
from pipelines.setup.table import Setup, VideoStream, VoiceStream
from pipelines.topology import Segment
from telepresence.link.profile import LinkProfile

#: Which process counts what of a stream.
_SENT = ("frames_captured", "frames_encoded", "frames_sent", "frames_refused")
_RECEIVED = (
    "rtp_packets",
    "rtp_lost",
    "rtp_reordered",
    "rtp_duplicates",
    "rtp_late",
    "garbage",
    "frames_damaged",
    "frames_concealed",
    "frames_recovered",
    "frames_corrupt",
    "frames_undated",
    "frames_oversized",
)

#: Gauges that say how a process is, and are worth a line in the report.
_WORTH_TELLING = (
    "source_fault",
    "scheduler",
    "selected",
    "jitter_ns",
    "playout_delay_ns",
    "last_error",
)


def build_report(
    setup: Setup,
    collector: Collector,
    *,
    seconds: float,
    cpu_s: Mapping[str, float],
    restarts: Mapping[str, int],
    launcher_cpu_s: float,
    media: bool = True,
) -> dict[str, Any]:
    """The whole report.

    seconds: how long the session ran. cpu_s, restarts: of each process, over all its lives.
    media: without, the session had no streams, whatever its setup says.
    """
    streams = setup.streams if media else ()
    uplink = link_figures(setup, collector, "uplink")
    return {
        "setup": setup.name,
        "seconds": round(seconds, 3),
        "streams": {stream.name: _stream(stream, setup, collector, seconds) for stream in streams},
        "haptic": {name: _haptic(name, setup, collector, seconds) for name in HAPTIC_ENDS},
        "joystick": collector.process("joystick").gauges.get("joystick"),
        "link": {
            "uplink": uplink,
            "downlink": link_figures(setup, collector, "downlink"),
        },
        "gateways": {end: gateway_figures(collector, end) for end in ("ground", "space")},
        # A setup without voices has nothing to compare them with.
        "skew_ms": {
            name: skew.summary_ms() if skew.count else None
            for name, skew in collector.skews.items()
        },
        "video_lead": video_lead(
            setup,
            collector.streams[setup.uplink_video.name].way,
            uplink,
            force_ns=collector.haptics["up"].latency.mean,
            epoch_ns=_radio_epoch_ns(collector),
        ),
        "sync": sync_section(setup, collector.sync, media=media),
        "lip_sync": collector.lip_sync.summary() if collector.lip_sync.counted_ns else None,
        "cpu": {
            "total_s": round(sum(cpu_s.values()) + launcher_cpu_s, 2),
            "launcher_s": round(launcher_cpu_s, 2),
            "cores_used": round((sum(cpu_s.values()) + launcher_cpu_s) / max(seconds, 1e-9), 3),
        },
        "processes": {
            name: {
                "cpu_s": round(cpu_s[name], 3),
                "restarts": restarts[name],
                **_told(name, setup, collector),
            }
            for name in cpu_s
        },
        "failures": failures(setup, collector, seconds, media=media),
    }


def _radio_epoch_ns(collector: Collector) -> int:
    """When the radio's time began: with its gateway."""
    for link in collector.process(collector.topology.gateway(Segment.GROUND).name).links():
        if "supervision" in link:
            begun_ns: int = link["supervision"]["begun_ns"]
            return begun_ns
    return 0


def _pauses_s(pauses: Pauses, collector: Collector) -> list[list[float]]:
    """From when to when, in seconds of the session: from its begin to the last that was told."""
    epoch_ns = _radio_epoch_ns(collector)
    end_ns = max((told.told_ns for told in collector.processes.values()), default=epoch_ns)
    return [
        [round((at - epoch_ns) / NS_PER_S, 3) for at in pause]
        for pause in pauses.within(epoch_ns, end_ns)
    ]


def _stream(
    stream: VideoStream | VoiceStream, setup: Setup, collector: Collector, seconds: float
) -> dict[str, Any]:
    figures = collector.streams[stream.name]
    sender = collector.process(collector.topology.media(stream.name).sender)
    receiver = collector.process(collector.topology.media(stream.name).receiver)
    displayed = displayed_frames(collector, stream.name)
    return {
        "cap_bps": stream.cap_bps,
        **_gained(sender, seconds),
        **_sizes(stream),
        "payload_bps_mean": round(figures.rate.octets * 8 / max(seconds, 1e-9)),
        "payload_bps_max_1s": round(figures.rate.max_bps(NS_PER_S)),
        "payload_bps_max_100ms": round(figures.rate.max_bps(100 * NS_PER_MS)),
        **{name: sender.total(name) for name in _SENT},
        "frames_displayed": displayed,
        "displayed_hz": round(displayed / max(seconds, 1e-9), 2),
        **{name: receiver.total(name) for name in _RECEIVED if name in receiver.names()},
        "stale_after_ms": round(setup.stale_after_ns(stream) / NS_PER_MS, 3),
        **spells(stream, collector),
        "latency_ms": {
            **spread_ms(figures.latency),
            "stages": {stage: spread_ms(histogram) for stage, histogram in figures.stages.items()},
        },
        "pauses_s": _pauses_s(figures.pauses, collector),
        "capture_stamp_error_us": round(figures.stamp_error.max / NS_PER_US, 1),
    }


def _gained(sender: ProcessFigures, seconds: float) -> dict[str, int]:
    """By how much the cap was higher, on average, because haptic samples were left out."""
    if "gained_bits" not in sender.names():
        return {}
    gained_bps = round(sender.total("gained_bits") / max(seconds, 1e-9))
    return {"gained_bps": gained_bps, "gain_changes": sender.total("gain_changes")}


def _sizes(stream: VideoStream | VoiceStream) -> dict[str, Any]:
    if not isinstance(stream, VideoStream):
        return {}
    return {"size": [stream.width, stream.height], "coded_size": list(stream.coded_size)}


def displayed_frames(collector: Collector, stream: str) -> int:
    """Pictures or blocks of sound that reached their display."""
    return collector.total(f"{stream}.frames_displayed")


def _haptic(name: str, setup: Setup, collector: Collector, seconds: float) -> dict[str, Any]:
    sender, receiver = (collector.process(end) for end in HAPTIC_ENDS[name])
    profile = setup.uplink if name == "up" else setup.downlink
    return {
        "cap_bps": haptic_cap_bps(profile),
        "payload_bps_mean": haptic_bps(profile, receiver.total("received"), seconds),
        "sent": sender.total("sent"),
        **_saved(profile, sender, seconds),
        "received": receiver.total("received"),
        "lost": receiver.total("lost"),
        "late": receiver.total("late"),
        "garbage": receiver.total("garbage"),
        "latency_ms": spread_ms(collector.haptics[name].latency),
        "pauses_s": _pauses_s(collector.haptics[name].pauses, collector),
        "lateness_us": summary_us(sender.lateness),
        "slips": sender.total("slips"),
        "port": _port(sender),
    }


def _port(end: ProcessFigures) -> dict[str, Any]:
    """The energies (µJ) of the port at the sender of a direction, and its passivity controller."""
    totals = {name: end.total(name) for name in PORT_TOTALS}
    return totals | {name: end.gauges[name] for name in PORT_GAUGES if name in end.gauges}


def _saved(profile: LinkProfile, sender: ProcessFigures, seconds: float) -> dict[str, int]:
    """Samples that were left out, because nobody would have felt the difference."""
    if "left_out" not in sender.names():
        return {}
    left_out = sender.total("left_out")
    return {"left_out": left_out, "saved_bps": haptic_bps(profile, left_out, seconds)}


def haptic_cap_bps(profile: LinkProfile) -> int:
    """What the insert zone of every frame makes."""
    return profile.insert_octets * 8 * NS_PER_S // profile.slot_ns


def haptic_bps(profile: LinkProfile, samples: int, seconds: float) -> int:
    """The rate of `samples` in `seconds`."""
    return round(samples * profile.insert_octets * 8 / max(seconds, 1e-9))


def _told(name: str, setup: Setup, collector: Collector) -> dict[str, Any]:
    figures = collector.process(name)
    told = {gauge: figures.gauges[gauge] for gauge in _WORTH_TELLING if gauge in figures.gauges}
    for silence in silences(setup, collector):
        if silence.process == name:
            told["silent_s"] = round(silence.silent_ns / NS_PER_S, 1)
    return {**told, "counts": {count: figures.total(count) for count in figures.names()}}


def failures(
    setup: Setup, collector: Collector, seconds: float, *, media: bool = True
) -> list[str]:
    """What went wrong by the project's own measure; an empty list is a run that went well."""
    found = []
    delay_ns = setup.radio_profile.longest_delay_ns
    # What the radio keeps back is its own affair: only what was missed with a signal counts.
    signals_ns = {segment: signal_ns(segment, collector) for segment in ("ground", "space")}
    whole_ns = round(seconds * NS_PER_S)
    for stream in setup.streams if media else ():
        figures = collector.streams[stream.name]
        above_bps, largest_bps = figures.above_cap_bps
        if above_bps > 0:
            found.append(f"{stream.name}: {largest_bps:.0f} bit/s in 1 s, above its cap")
        still_ns = stopped_ns(stream, setup, collector)
        heard_ns = signals_ns[collector.topology.media(stream.name).direction.receiver.value]
        long_enough = min(whole_ns, heard_ns) >= MISSED_NS + delay_ns
        if long_enough and displayed_frames(collector, stream.name) == 0:
            found.append(f"{stream.name}: nothing was displayed")
        elif min(still_ns, heard_ns) >= missed_ns(stream) + delay_ns:
            found.append(
                f"{stream.name}: nothing was displayed in the last {still_ns / NS_PER_S:.1f} s, "
                "though its input went on"
            )
        for stage, count in figures.negative().items():
            found.append(f"{stream.name}: {count} latencies below 0 ({stage})")
    for name in HAPTIC_ENDS:
        receiver = collector.process(HAPTIC_ENDS[name][1])
        heard_ns = signals_ns["space" if name == "up" else "ground"]
        long_enough = min(whole_ns, heard_ns) >= MISSED_NS + delay_ns
        if long_enough and receiver.total("received") == 0:
            found.append(f"haptic_{name}: no sample was received")
        end = HAPTIC_ENDS[name][0]
        least_uj = collector.process(end).gauges.get("least_uj", 0)
        # A count of the energy in a sample is rounding.
        if least_uj < -1:
            found.append(f"{end}: its port gave out {-least_uj} µJ that nobody had granted")
    joystick = collector.process("joystick").gauges.get("joystick")
    if joystick is not None and joystick["state"].endswith("error"):
        found.append(f"joystick: {joystick['state']}: {joystick['reason']}")
    found += disagreements(sync_section(setup, collector.sync, media=media))
    for process, told in collector.processes.items():
        dropped = told.total("probe_values_dropped")
        if dropped:
            found.append(f"{process}: {dropped} values for this report were lost")
    return found


def spread_ms(histogram: Histogram) -> dict[str, float]:
    """Percentiles, `max`, `mean` and `count` of values in ns, in ms."""
    summary = histogram.summary_ms()
    largest = summary.pop("max")
    summary["p99.9"] = histogram.percentile(99.9) / NS_PER_MS
    return {
        **rounded({**summary, "max": largest, "mean": histogram.mean / NS_PER_MS}),
        "count": histogram.count,
    }


def rounded(summary: Mapping[str, float]) -> dict[str, float]:
    """To the microsecond: more digits would be noise."""
    return {name: round(value, 3) for name, value in summary.items()}


def latency_ms(figures: StreamFigures) -> float | None:
    """The latency of what was displayed last."""
    newest = figures.last_latency_ns
    return None if newest is None else newest / NS_PER_MS
