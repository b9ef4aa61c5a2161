"""One report for every run: what each stream got, as plain values for JSON."""

from collections.abc import Mapping
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from pipelines.collector import HAPTIC_ENDS, Collector, ProcessFigures, StreamFigures
from pipelines.setup import Setup, VideoStream, VoiceStream
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
)

#: Gauges that say how a process is, and are worth a line in the report.
_WORTH_TELLING = ("source", "source_fault", "scheduler", "selected", "last_error")


def build_report(
    setup: Setup,
    collector: Collector,
    *,
    seconds: float,
    cpu_s: Mapping[str, float],
    restarts: Mapping[str, int],
    launcher_cpu_s: float,
) -> dict[str, Any]:
    """The whole report.

    seconds: how long the session ran. cpu_s, restarts: of each process, over all its lives.
    """
    return {
        "setup": setup.name,
        "seconds": round(seconds, 3),
        "streams": {stream.name: _stream(stream, collector, seconds) for stream in setup.streams},
        "haptic": {name: _haptic(name, setup, collector, seconds) for name in HAPTIC_ENDS},
        "link": {
            "uplink": _link(setup, collector, "uplink"),
            "downlink": _link(setup, collector, "downlink"),
        },
        "skew_ms": {name: skew.summary_ms() for name, skew in collector.skews.items()},
        "cpu": {
            "total_s": round(sum(cpu_s.values()) + launcher_cpu_s, 2),
            "launcher_s": round(launcher_cpu_s, 2),
            "cores_used": round((sum(cpu_s.values()) + launcher_cpu_s) / max(seconds, 1e-9), 3),
        },
        "processes": {
            name: {
                "cpu_s": round(cpu_s[name], 3),
                "restarts": restarts[name],
                **_told(collector.process(name)),
            }
            for name in cpu_s
        },
        "failures": failures(setup, collector, seconds),
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
        "payload_bps_mean": round(figures.rate.mean_bps()),
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


def _link(setup: Setup, collector: Collector, direction: str) -> dict[str, Any]:
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
        "queue": lives[-1]["queue"] if lives else {},
        "headers": lives[-1]["headers"] if lives else {},
        "refused": _sum_tables([life["refused"] for life in lives]),
        "packets": _sum_tables([life["packets"] for life in received]),
        "packets_dropped": _sum_tables([life["packets_dropped"] for life in received]),
        "lateness_us": summary_us(near.lateness),
        "slips": near.total("slips"),
    }


def _sum_tables(tables: list[dict[str, int]]) -> dict[str, int]:
    sums: dict[str, int] = {}
    for table in tables:
        for name, value in table.items():
            sums[name] = sums.get(name, 0) + value
    return sums


def _told(figures: ProcessFigures) -> dict[str, Any]:
    told = {name: figures.gauges[name] for name in _WORTH_TELLING if name in figures.gauges}
    if "garbage" in figures.names():
        told["garbage"] = figures.total("garbage")
    return told


def failures(setup: Setup, collector: Collector, seconds: float) -> list[str]:
    """What went wrong by the project's own measure; an empty list is a run that went well."""
    found = []
    for stream in setup.streams:
        figures = collector.streams[stream.name]
        largest_bps = figures.rate.max_bps(NS_PER_S)
        if largest_bps > stream.cap_bps:
            found.append(f"{stream.name}: {largest_bps:.0f} bit/s in 1 s, above its cap")
        if seconds >= 2 and displayed_frames(collector, stream.name) == 0:
            found.append(f"{stream.name}: nothing was displayed")
    for name in HAPTIC_ENDS:
        receiver = collector.process(HAPTIC_ENDS[name][1])
        if seconds >= 2 and receiver.total("received") == 0:
            found.append(f"haptic_{name}: no sample was received")
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
