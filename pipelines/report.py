"""One report for every run: what each stream got, as plain values for JSON."""

from collections.abc import Mapping
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from pipelines.collector import HAPTIC_ENDS, Collector, StreamFigures
from pipelines.setup import Setup, VideoStream, VoiceStream
from pipelines.silence import MISSED_NS, missed_ns, signal_ns, silences, stopped_ns
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
    return {
        "setup": setup.name,
        "seconds": round(seconds, 3),
        "streams": {stream.name: _stream(stream, collector, seconds) for stream in streams},
        "haptic": {name: _haptic(name, setup, collector, seconds) for name in HAPTIC_ENDS},
        "link": {
            "uplink": link_figures(setup, collector, "uplink"),
            "downlink": link_figures(setup, collector, "downlink"),
        },
        # A setup without voices has nothing to compare them with.
        "skew_ms": {
            name: skew.summary_ms() if skew.count else None
            for name, skew in collector.skews.items()
        },
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


def _stream(
    stream: VideoStream | VoiceStream, collector: Collector, seconds: float
) -> dict[str, Any]:
    figures = collector.streams[stream.name]
    sender = collector.process(f"{stream.name}_send")
    receiver = collector.process(f"{stream.name}_receive")
    displayed = displayed_frames(collector, stream.name)
    return {
        "cap_bps": stream.cap_bps,
        "payload_bps_mean": round(figures.rate.octets * 8 / max(seconds, 1e-9)),
        "payload_bps_max_1s": round(figures.rate.max_bps(NS_PER_S)),
        "payload_bps_max_100ms": round(figures.rate.max_bps(100 * NS_PER_MS)),
        **{name: sender.total(name) for name in _SENT},
        "frames_displayed": displayed,
        "displayed_hz": round(displayed / max(seconds, 1e-9), 2),
        **{name: receiver.total(name) for name in _RECEIVED if name in receiver.names()},
        "latency_ms": {
            **rounded(figures.latency.summary_ms()),
            "stages": {
                stage: rounded(histogram.summary_ms())
                for stage, histogram in figures.stages.items()
            },
        },
        "capture_stamp_error_us": round(figures.stamp_error.max / NS_PER_US, 1),
    }


def displayed_frames(collector: Collector, stream: str) -> int:
    """Pictures or blocks of sound that reached their display."""
    return sum(
        figures.total(f"{stream}.frames_displayed") for figures in collector.processes.values()
    )


def _haptic(name: str, setup: Setup, collector: Collector, seconds: float) -> dict[str, Any]:
    sender, receiver = (collector.process(end) for end in HAPTIC_ENDS[name])
    profile = setup.uplink if name == "up" else setup.downlink
    return {
        "cap_bps": haptic_cap_bps(profile),
        "payload_bps_mean": haptic_bps(profile, receiver.total("received"), seconds),
        "sent": sender.total("sent"),
        "received": receiver.total("received"),
        "lost": receiver.total("lost"),
        "late": receiver.total("late"),
        "garbage": receiver.total("garbage"),
        "latency_ms": rounded(collector.haptics[name].latency.summary_ms()),
        "lateness_us": summary_us(sender.lateness),
        "slips": sender.total("slips"),
    }


def haptic_cap_bps(profile: LinkProfile) -> int:
    """What the insert zone of every frame makes."""
    return profile.insert_octets * 8 * NS_PER_S // profile.slot_ns


def haptic_bps(profile: LinkProfile, samples: int, seconds: float) -> int:
    """The rate of `samples` in `seconds`."""
    return round(samples * profile.insert_octets * 8 / max(seconds, 1e-9))


def link_figures(setup: Setup, collector: Collector, direction: str) -> dict[str, Any]:
    """One direction of the link, as far as its two gateways have told of it."""
    up = direction == "uplink"
    near = collector.process("ground_gateway" if up else "space_gateway")
    far = collector.process("space_gateway" if up else "ground_gateway")
    lives = [link["transmit"] for link in near.links()]
    need = setup.need_up() if up else setup.need_down()
    profile = setup.uplink if up else setup.downlink
    octets: dict[str, int] = {}
    for life in lives:
        for kind, count in life["octets"].items():
            octets[kind] = octets.get(kind, 0) + count
    received = [link["receive"] for link in far.links()]
    return {
        "capacity_bps": profile.capacity_bps,
        "below_haptics_bps": profile.media_bps,
        "needed_at_caps_bps": {
            "payload": need.payload_bps,
            "headers": need.overhead_bps,
            "reserve": need.reserve_bps,
            "spare": need.spare_bps,
        },
        "frames": sum(life["frames"] for life in lives),
        "frames_lost": sum(life["frames_lost"] for life in received),
        "frames_dropped": _sum_tables([life["frames_dropped"] for life in received]),
        "octets": octets,
        "queue": _merged_queues([life["queue"] for life in lives]),
        "headers": _merged_headers([life["headers"] for life in lives]),
        "refused": _sum_tables([life["refused"] for life in lives]),
        "packets": _sum_tables([life["packets"] for life in received]),
        "packets_dropped": _sum_tables([life["packets_dropped"] for life in received]),
        "lateness_us": summary_us(near.lateness),
        "sent_after_us": summary_us(near.sending),
        "slips": near.total("slips"),
    }


def _sum_tables(tables: list[dict[str, int]]) -> dict[str, int]:
    sums: dict[str, int] = {}
    for table in tables:
        for name, value in table.items():
            sums[name] = sums.get(name, 0) + value
    return sums


def _merged_queues(lives: list[dict[str, dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Each level's queue: as the last life left it, with what all lives counted."""
    merged: dict[str, dict[str, Any]] = {}
    for life in lives:
        for level, queue in life.items():
            before = merged.get(level)
            merged[level] = dict(queue)
            if before is None:
                continue
            merged[level].update(
                accepted=before["accepted"] + queue["accepted"],
                drops=_sum_tables([before["drops"], queue["drops"]]),
                **{name: max(before[name], queue[name]) for name in ("max_octets", "max_age_ns")},
            )
    return merged


def _merged_headers(lives: list[dict[str, dict[str, int]]]) -> dict[str, dict[str, int]]:
    flows = dict.fromkeys(flow for life in lives for flow in life)
    return {flow: _sum_tables([life.get(flow, {}) for life in lives]) for flow in flows}


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
        largest_bps = figures.rate.max_bps(NS_PER_S)
        if largest_bps > stream.cap_bps:
            found.append(f"{stream.name}: {largest_bps:.0f} bit/s in 1 s, above its cap")
        still_ns = stopped_ns(stream, setup, collector)
        heard_ns = signals_ns["space" if stream.name.startswith("uplink_") else "ground"]
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
    for process, told in collector.processes.items():
        dropped = told.total("probe_values_dropped")
        if dropped:
            found.append(f"{process}: {dropped} values for this report were lost")
    return found


def rounded(summary: Mapping[str, float]) -> dict[str, float]:
    """To the microsecond: more digits would be noise."""
    return {name: round(value, 3) for name, value in summary.items()}


def summary_us(histogram: Histogram) -> dict[str, float]:
    """A histogram's summary in microseconds."""
    return {
        **{name: round(value * 1000, 1) for name, value in histogram.summary_ms().items()},
        "p99.9": round(histogram.percentile(99.9) / NS_PER_US, 1),
    }


def latency_ms(figures: StreamFigures) -> float | None:
    """The latency of what was displayed last."""
    newest = figures.last_latency_ns
    return None if newest is None else newest / NS_PER_MS
