"""One report for every run: what each stream got, as plain values for JSON."""

from collections.abc import Mapping

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from pipelines.report.collector import Collector, Pauses, StreamFigures
from pipelines.report.link_figures import gateway_figures, link_figures, punctuality_us
from pipelines.report.model import (
    CpuReport,
    HapticReport,
    PortReport,
    ProcessReport,
    SessionReport,
    Spread,
    Stages,
    StreamLatency,
    StreamReport,
)
from pipelines.report.silence import MISSED_NS, missed_ns, signal_ns, silences, stopped_ns
from pipelines.report.sync.figures import disagreements
from pipelines.report.sync.section import sync_section
from pipelines.report.terms import video_lead
from pipelines.report.warnings import find_warnings
from pipelines.setup.table import Setup, VideoStream, VoiceStream
from pipelines.topology import HapticRow, Segment
from telepresence.link.profile import LinkProfile


def build_report(
    setup: Setup,
    collector: Collector,
    *,
    seconds: float,
    cpu_s: Mapping[str, float],
    restarts: Mapping[str, int],
    launcher_cpu_s: float,
    media: bool = True,
) -> SessionReport:
    """The whole report.

    seconds: how long the session ran. cpu_s, restarts: of each process, over all its lives.
    media: False if the session had no streams, whatever its setup says.
    """
    streams = setup.streams if media else ()
    uplink = link_figures(setup, collector, "uplink")
    return SessionReport(
        setup=setup.name,
        seconds=round(seconds, 3),
        streams={stream.name: _stream(stream, setup, collector, seconds) for stream in streams},
        haptic={
            row.key: _haptic(row, setup, collector, seconds) for row in collector.topology.haptics
        },
        joystick=collector.process("joystick").gauges.get("joystick"),
        link={"uplink": uplink, "downlink": link_figures(setup, collector, "downlink")},
        gateways={end: gateway_figures(collector, end) for end in ("ground", "space")},
        # A setup without voices has nothing to compare them with.
        skew_ms={
            name: skew.summary_ms() if skew.count else None
            for name, skew in collector.skews.items()
        },
        video_lead=video_lead(
            setup,
            collector.streams[setup.uplink_video.name].way,
            uplink,
            force_ns=collector.haptics["up"].latency.mean,
            epoch_ns=_radio_epoch_ns(collector),
        ),
        sync=sync_section(setup, collector.sync, media=media),
        lip_sync=collector.lip_sync.summary() if collector.lip_sync.counted_ns else None,
        cpu=cpu_report(cpu_s, launcher_cpu_s, seconds),
        processes={
            name: _process(name, cpu_s[name], restarts[name], setup, collector) for name in cpu_s
        },
        failures=failures(setup, collector, seconds, media=media),
        warnings=find_warnings(setup, collector, seconds=seconds, restarts=restarts, media=media),
    )


def cpu_report(cpu_s: Mapping[str, float], launcher_cpu_s: float, seconds: float) -> CpuReport:
    """The CPU time of a session of `seconds`."""
    total_s = sum(cpu_s.values()) + launcher_cpu_s
    return CpuReport(
        total_s=round(total_s, 2),
        launcher_s=round(launcher_cpu_s, 2),
        cores_used=round(total_s / max(seconds, 1e-9), 3),
    )


def _radio_epoch_ns(collector: Collector) -> int:
    """When the radio's time began: with its gateway."""
    for link in collector.process(collector.topology.gateway(Segment.GROUND).name).links():
        return link.supervision.begun_ns
    return 0


def _pauses_s(pauses: Pauses, collector: Collector) -> list[tuple[float, float]]:
    """From when to when, in seconds of the session: from its begin to the last that was told."""
    epoch_ns = _radio_epoch_ns(collector)
    end_ns = max((told.told_ns for told in collector.processes.values()), default=epoch_ns)
    return [
        (round((begin_ns - epoch_ns) / NS_PER_S, 3), round((until_ns - epoch_ns) / NS_PER_S, 3))
        for begin_ns, until_ns in pauses.within(epoch_ns, end_ns)
    ]


def _stream(
    stream: VideoStream | VoiceStream, setup: Setup, collector: Collector, seconds: float
) -> StreamReport:
    figures = collector.streams[stream.name]
    sender = collector.process(collector.topology.media(stream.name).sender)
    receiver = collector.process(collector.topology.media(stream.name).receiver)
    displayed = displayed_frames(collector, stream.name)
    video = isinstance(stream, VideoStream)
    gained = sender.counted("gained_bits")
    return StreamReport(
        cap_bps=stream.cap_bps,
        gained_bps=None if gained is None else round(gained / max(seconds, 1e-9)),
        gain_changes=sender.counted("gain_changes"),
        size=(stream.width, stream.height) if isinstance(stream, VideoStream) else None,
        coded_size=stream.coded_size if isinstance(stream, VideoStream) else None,
        payload_bps_mean=round(figures.rate.octets * 8 / max(seconds, 1e-9)),
        payload_bps_max_1s=round(figures.rate.max_bps(NS_PER_S)),
        payload_bps_max_100ms=round(figures.rate.max_bps(100 * NS_PER_MS)),
        frames_captured=sender.total("frames_captured"),
        frames_encoded=sender.total("frames_encoded"),
        frames_sent=sender.total("frames_sent"),
        frames_refused=sender.total("frames_refused"),
        frames_displayed=displayed,
        displayed_hz=round(displayed / max(seconds, 1e-9), 2),
        rtp_packets=receiver.counted("rtp_packets"),
        rtp_lost=receiver.counted("rtp_lost"),
        rtp_reordered=receiver.counted("rtp_reordered"),
        rtp_duplicates=receiver.counted("rtp_duplicates"),
        rtp_late=receiver.counted("rtp_late"),
        garbage=receiver.counted("garbage"),
        frames_damaged=receiver.counted("frames_damaged"),
        frames_concealed=receiver.counted("frames_concealed"),
        frames_recovered=receiver.counted("frames_recovered"),
        frames_corrupt=receiver.counted("frames_corrupt"),
        frames_undated=receiver.counted("frames_undated"),
        frames_oversized=receiver.counted("frames_oversized"),
        stale_after_ms=round(setup.stale_after_ns(stream) / NS_PER_MS, 3),
        stale_ms=_spell_ms(stream.name, "stale", collector),
        stale_episodes=_spell_episodes(stream.name, "stale", collector),
        frozen_ms=_spell_ms(stream.name, "frozen", collector) if video else None,
        frozen_episodes=_spell_episodes(stream.name, "frozen", collector) if video else None,
        damaged_ms=_spell_ms(stream.name, "damaged", collector) if video else None,
        damaged_episodes=_spell_episodes(stream.name, "damaged", collector) if video else None,
        latency_ms=_latency_ms(figures),
        pauses_s=_pauses_s(figures.pauses, collector),
        capture_stamp_error_us=round(figures.stamp_error.max / NS_PER_US, 1),
    )


def _latency_ms(figures: StreamFigures) -> StreamLatency:
    whole = spread_ms(figures.latency)
    return StreamLatency(
        p50=whole.p50,
        p95=whole.p95,
        p99=whole.p99,
        p99_9=whole.p99_9,
        max=whole.max,
        mean=whole.mean,
        count=whole.count,
        stages=Stages(
            **{stage: spread_ms(histogram) for stage, histogram in figures.stages.items()}
        ),
    )


def displayed_frames(collector: Collector, stream: str) -> int:
    """Pictures or blocks of sound that reached their display."""
    return collector.total(f"{stream}.frames_displayed")


def _haptic(row: HapticRow, setup: Setup, collector: Collector, seconds: float) -> HapticReport:
    sender, receiver = collector.process(row.sender), collector.process(row.receiver)
    profile, figures = setup.profile(row.direction), collector.haptics[row.key]
    left_out = sender.counted("left_out")
    return HapticReport(
        cap_bps=haptic_cap_bps(profile),
        payload_bps_mean=haptic_bps(profile, receiver.total("received"), seconds),
        sent=sender.total("sent"),
        left_out=left_out,
        saved_bps=None if left_out is None else haptic_bps(profile, left_out, seconds),
        received=receiver.total("received"),
        lost=receiver.total("lost"),
        late=receiver.total("late"),
        garbage=receiver.total("garbage"),
        latency_ms=spread_ms(figures.latency),
        pauses_s=_pauses_s(figures.pauses, collector),
        lateness_us=punctuality_us(sender.lateness),
        slips=sender.total("slips"),
        port=PortReport(
            energy_in_uj=sender.total("energy_in_uj"),
            energy_out_uj=sender.total("energy_out_uj"),
            passivity_acted=sender.total("passivity_acted"),
            totals_refused=sender.total("totals_refused"),
            credit_uj=sender.gauges.get("credit_uj"),
            least_uj=sender.gauges.get("least_uj"),
        ),
    )


def haptic_cap_bps(profile: LinkProfile) -> int:
    """What the insert zone of every frame makes."""
    return profile.insert_octets * 8 * NS_PER_S // profile.slot_ns


def haptic_bps(profile: LinkProfile, samples: int, seconds: float) -> int:
    """The rate of `samples` in `seconds`."""
    return round(samples * profile.insert_octets * 8 / max(seconds, 1e-9))


def _process(
    name: str, cpu_s: float, restarts: int, setup: Setup, collector: Collector
) -> ProcessReport:
    figures = collector.process(name)
    told = figures.gauges.get
    silent_ns = next(
        (one.silent_ns for one in silences(setup, collector) if one.process == name), 0
    )
    return ProcessReport(
        cpu_s=round(cpu_s, 3),
        restarts=restarts,
        source_fault=told("source_fault"),
        scheduler=told("scheduler"),
        selected=told("selected"),
        jitter_ns=told("jitter_ns"),
        playout_delay_ns=told("playout_delay_ns"),
        last_error=told("last_error"),
        silent_s=round(silent_ns / NS_PER_S, 1) if silent_ns else None,
        counts={count: figures.total(count) for count in figures.names()},
    )


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
    for row in collector.topology.haptics:
        receiver = collector.process(row.receiver)
        heard_ns = signals_ns[row.direction.receiver.value]
        long_enough = min(whole_ns, heard_ns) >= MISSED_NS + delay_ns
        if long_enough and receiver.total("received") == 0:
            found.append(f"haptic_{row.key}: no sample was received")
        least_uj = collector.process(row.sender).gauges.get("least_uj", 0)
        # A count of the energy in a sample is rounding.
        if least_uj < -1:
            found.append(f"{row.sender}: its port gave out {-least_uj} µJ that nobody had granted")
    joystick = collector.process("joystick").gauges.get("joystick")
    if joystick is not None and joystick.state.endswith("error"):
        found.append(f"joystick: {joystick.state}: {joystick.reason}")
    found += disagreements(sync_section(setup, collector.sync, media=media))
    for process, told in collector.processes.items():
        dropped = told.total("probe_values_dropped")
        if dropped:
            found.append(f"{process}: {dropped} values for this report were lost")
    return found


def spread_ms(histogram: Histogram) -> Spread:
    """Percentiles of values in ns, in ms; to the microsecond, because more would be noise."""
    summary = histogram.summary_ms()
    return Spread(
        p50=round(summary["p50"], 3),
        p95=round(summary["p95"], 3),
        p99=round(summary["p99"], 3),
        p99_9=round(histogram.percentile(99.9) / NS_PER_MS, 3),
        max=round(summary["max"], 3),
        mean=round(histogram.mean / NS_PER_MS, 3),
        count=histogram.count,
    )


def latency_ms(figures: StreamFigures) -> float | None:
    """The latency of what was displayed last."""
    newest = figures.last_latency_ns
    return None if newest is None else newest / NS_PER_MS


def _spell_ms(stream: str, spell: str, collector: Collector) -> float:
    """The time (ms) for which `stream` was shown `stale`, `frozen` or `damaged`."""
    return round(collector.total(f"{stream}.{spell}_ns") / NS_PER_MS, 3)


def _spell_episodes(stream: str, spell: str, collector: Collector) -> int:
    """How many times `stream` began to be shown `stale`, `frozen` or `damaged`."""
    return collector.total(f"{stream}.{spell}_episodes")
