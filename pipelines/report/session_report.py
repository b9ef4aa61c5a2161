"""Builds the report of a session from the collected figures."""

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.report import rates
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.video_sender import FeedbackCounts
from kontur_av.streams.voice_receiver import LoudspeakerCounts, VoiceReceiverCounts
from pipelines.media.media_metrics import EncoderMetrics, GainMetrics
from pipelines.recording.recorder_metrics import FoxgloveMetrics
from pipelines.report import model, sections, silence
from pipelines.report.collector import Collector
from pipelines.report.journeys import Pauses, StreamMetrics
from pipelines.report.link_report import gateway_metrics, link_metrics, punctuality_us
from pipelines.report.sync_metrics import disagreements, sync_section
from pipelines.report.terms import video_lead
from pipelines.report.warnings import find_warnings
from pipelines.session.session_metrics import LoopMetrics, ProbeMetrics, ProcessNow
from pipelines.session.session_switch import lacks_room
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topology.rows import HapticRow
from pipelines.session.topology.topics import FOXGLOVE, JOYSTICK, ROBOT
from pipelines.session.verdict import process_failures
from telepresence.haptics.authority import AuthorityMetrics
from telepresence.haptics.envelope import SafetyMetrics
from telepresence.haptics.haptic_metrics import (
    JoystickMetrics,
    PortMetrics,
    PressMetrics,
    RobotMetrics,
    SamplesReceived,
    SamplesSent,
)
from telepresence.link.profile import LinkProfile


def build_report(
    collector: Collector,
    *,
    seconds: float,
    processes: Sequence[ProcessNow],
    launcher_cpu_s: float = 0.0,
    media: bool = True,
    stopped_s: Sequence[tuple[float, float]] = (),
    now_ns: int | None = None,
) -> model.SessionReport:
    """The whole report.

    seconds: how long the session ran. processes: as the launcher knows them.
    media: False if the session had no streams, whatever its setup says.
    stopped_s: from when to when it was stopped on request. That time is in no mean and no failure.
    now_ns: the present instant of a session that runs.
    """
    setup = collector.setup
    streams = setup.streams if media else ()
    whole_s, seconds = seconds, seconds - sum(end_s - begin_s for begin_s, end_s in stopped_s)
    uplink = link_metrics(collector, "uplink")
    topology, alone = collector.topology, collector.topology.alone
    silent = {each.process: each for each in silence.silences(collector, now_ns)}
    # Contacts are felt on the ground, and seen and heard in space.
    sync = None if alone else sync_section(setup, collector.sync, media=media)
    epoch_ns = _radio_epoch_ns(collector)
    restarts = {process.name: process.restarts for process in processes}
    return model.SessionReport(
        setup=setup.name,
        end=None if alone is None else alone.value,
        seconds=round(whole_s, 3),
        stopped_s=[(round(begin, 3), round(end, 3)) for begin, end in stopped_s] or None,
        streams={
            stream.name: stream_report(stream, collector, seconds, now_ns) for stream in streams
        },
        haptic={
            row.key: haptic_report(row, collector, seconds, now_ns) for row in topology.haptics
        },
        joystick=collector.process(JOYSTICK).find(JoystickMetrics),
        link={"uplink": uplink, "downlink": link_metrics(collector, "downlink")},
        gateways={end.value: gateway_metrics(collector, end.value) for end in topology.segments},
        skew_ms=skew_reports(collector),
        video_lead=video_lead(
            setup,
            collector.streams[setup.uplink_video.name].way,
            uplink,
            force_ns=collector.haptics["up"].latency.mean,
            epoch_ns=epoch_ns,
            bypass=topology.options.bypass,
        ),
        sync=sync,
        lip_sync=collector.lip_sync.summary() if collector.lip_sync.counted_ns else None,
        cpu=sections.cpu_report(processes, launcher_cpu_s, seconds),
        processes={
            process.name: sections.process_report(process, collector, silent.get(process.name))
            for process in processes
        },
        failures=[*failures(collector, seconds, sync, media=media), *process_failures(processes)],
        warnings=[
            *find_warnings(collector, seconds=seconds, restarts=restarts, media=media),
            *sections.recorder_warnings(collector),
            *sections.task_warnings(collector),
        ],
        recorder=sections.recorder_report(collector),
        foxglove=collector.process(FOXGLOVE).find(FoxgloveMetrics),
        exercises=sections.exercises(collector, epoch_ns),
        focus=sections.focuses(collector, epoch_ns),
        rtc=sections.rtc_report(collector, seconds),
        arm=sections.dated(collector.process(ROBOT).find(AuthorityMetrics), epoch_ns),
        safety=safety_report(collector),
        robot=collector.process(ROBOT).find(RobotMetrics),
        second_arm=sections.second_arm_report(collector),
        tasks=sections.task_runs(collector, epoch_ns),
        telemetry=sections.component_reports(collector, epoch_ns),
    )


def safety_report(collector: Collector) -> SafetyMetrics | None:
    """Return what held the robot; None without the robot's end."""
    epoch_ns = _radio_epoch_ns(collector)
    told = sections.dated(collector.process(ROBOT).find(SafetyMetrics), epoch_ns)
    return told and replace(told, since_s=round(told.since_s - epoch_ns / NS_PER_S, 3))


def skew_reports(collector: Collector) -> dict[str, model.SkewReport | None]:
    """The skews by name; None where nothing was compared, as in a setup without voices."""
    return {
        name: skew.summary_ms() if skew.count else None for name, skew in collector.skews.items()
    }


def _radio_epoch_ns(collector: Collector) -> int:
    """When the radio's time began: with its gateway."""
    for link in collector.gateway(collector.topology.segments[0]).links():
        return link.supervision.begun_ns
    return 0


def _pauses_s(pauses: Pauses, collector: Collector) -> list[tuple[float, float]]:
    """Begin and end of each pause, in seconds of the session, until its last report."""
    epoch_ns = _radio_epoch_ns(collector)
    end_ns = max((told.told_ns for told in collector.processes.values()), default=epoch_ns)
    return pauses.within_s(epoch_ns, end_ns)


def stream_report(
    stream: VideoStream | VoiceStream,
    collector: Collector,
    seconds: float,
    now_ns: int | None = None,
) -> model.StreamReport:
    """One stream. now_ns: what is shown and sent at that instant; None once it has ended."""
    metrics = collector.streams[stream.name]
    row = collector.topology.media(stream.name)
    sender, receiver = collector.process(row.sender), collector.process(row.receiver)
    gain, display = sender.find(GainMetrics), collector.shown(stream.name)
    encoder, voice = sender.find(EncoderMetrics), isinstance(stream, VoiceStream)
    seconds, newest_ns = max(seconds, 1e-9), metrics.last_latency_ns
    if now_ns is not None:
        state, age_ns = silence.shown_now(stream, collector, now_ns)
        display = replace(display, state=state, age_ns=age_ns)
    return model.StreamReport(
        side=collector.topology.side_here(row),
        cap_bps=stream.cap_bps,
        gained_bps=None if gain is None else round(gain.gained_bits / seconds),
        gain=gain,
        size=(stream.width, stream.height) if isinstance(stream, VideoStream) else None,
        coded_size=stream.coded_size if isinstance(stream, VideoStream) else None,
        encoder=None if encoder is None else encoder.encoder,
        **rates(metrics.rate, metrics.rate.octets * 8 / seconds),
        above_cap_bps=round(metrics.above_cap_bps[0]),
        rate_bps=None if now_ns is None else round(silence.last_bps(metrics.rate, now_ns)),
        sender=sender.total(SenderCounts),
        feedback=sender.find(FeedbackCounts),
        video=receiver.find(VideoReceiverCounts),
        voice=receiver.find(VoiceReceiverCounts),
        decoder=receiver.find(DecoderCounts),
        display=display,
        playback=collector.process(row.display).find(LoudspeakerCounts) if voice else None,
        displayed_hz=round(display.frames_displayed / seconds, 2),
        stale_after_ms=_ms(collector.setup.stale_after_ns(stream)),
        latency_ms=stream_latency_ms(metrics),
        newest_ms=None if now_ns is None or newest_ns is None else _ms(newest_ns),
        latency_error_ms=_ms(metrics.error_ns) if metrics.error_ns else None,
        pauses_s=_pauses_s(metrics.pauses, collector),
        capture_stamp_error_us=round(metrics.stamp_error.max / NS_PER_US, 1),
    )


def stream_latency_ms(metrics: StreamMetrics) -> model.StreamLatency:
    return model.StreamLatency(
        **msgspec.structs.asdict(sections.spread_ms(metrics.latency)),
        stages=model.Stages(
            **{stage: sections.spread_ms(histogram) for stage, histogram in metrics.stages.items()}
        ),
    )


def _ms(value_ns: int) -> float:
    return round(value_ns / NS_PER_MS, 3)


def haptic_report(
    row: HapticRow, collector: Collector, seconds: float, now_ns: int | None = None
) -> model.HapticReport:
    """One direction of the samples. now_ns: as for a stream."""
    sender, receiver = collector.process(row.sender), collector.process(row.receiver)
    profile, metrics = collector.setup.profile(row.direction), collector.haptics[row.key]
    sent, received = sender.total(SamplesSent), receiver.total(SamplesReceived)
    left_out = sent.left_out
    more = collector.setup.more_axes if collector.setup.force == "felt" else ()
    axes = {str(name): sender.total(PortMetrics, name) for name in more}
    return model.HapticReport(
        side=collector.topology.side_here(row),
        cap_bps=haptic_cap_bps(profile),
        payload_bps_mean=haptic_bps(profile, received.received, seconds),
        rate_bps=None if now_ns is None else round(silence.last_bps(metrics.rate, now_ns)),
        sender=sent,
        saved_bps=None if left_out is None else haptic_bps(profile, left_out, seconds),
        receiver=received,
        latency_ms=sections.spread_ms(metrics.latency),
        unmatched=metrics.unmatched,
        pauses_s=_pauses_s(metrics.pauses, collector),
        lateness_us=punctuality_us(sender.lateness),
        loop=sender.total(LoopMetrics),
        port=sender.total(PortMetrics),
        axes=axes or None,
        press=sender.find(PressMetrics),
    )


def haptic_cap_bps(profile: LinkProfile) -> int:
    """The rate of the insert zones of all frames that samples have room in."""
    return profile.sample_bps


def haptic_bps(profile: LinkProfile, samples: int, seconds: float) -> int:
    return round(samples * profile.insert_octets * 8 / max(seconds, 1e-9))


def failures(
    collector: Collector,
    seconds: float,
    sync: model.SyncReport | None = None,
    *,
    media: bool = True,
) -> list[str]:
    """What broke a promise of the project; empty for a good run. sync: of the same report."""
    setup = collector.setup
    found = silence.never_met(collector, seconds)
    topology = collector.topology
    delay_ns = setup.radio_profile.longest_delay_ns
    # The radio may keep all back. So only what is missed while there is a signal counts.
    signals_ns = {segment: silence.signal_ns(segment, collector) for segment in ("ground", "space")}
    whole_ns = round(seconds * NS_PER_S)
    for stream in setup.streams if media else ():
        metrics = collector.streams[stream.name]
        above_bps, largest_bps = metrics.above_cap_bps
        if above_bps > 0:
            found.append(f"{stream.name}: {largest_bps:.0f} bit/s in 1 s, above its cap")
        if topology.alone is not None:
            # Whether the other machine sends or shows anything is not known here.
            continue
        still_ns = silence.stopped_ns(stream, collector)
        heard_ns = signals_ns[collector.topology.media(stream.name).direction.receiver.value]
        met_ns = silence.met_ns(collector.topology.media(stream.name).direction.receiver, collector)
        never = collector.shown(stream.name).frames_displayed == 0
        if never and min(whole_ns, met_ns) >= silence.MISSED_NS + delay_ns:
            # What nobody gives is not missed, unless the session has shown no picture at all.
            if not silence.waits_for_page(stream, collector) or silence.is_blind(collector):
                why = silence.why_nothing(stream, collector)
                found.append(f"{stream.name}: nothing was displayed: {why}")
        elif min(still_ns, heard_ns) >= silence.missed_ns(stream) + delay_ns:
            found.append(
                f"{stream.name}: nothing was displayed in the last {still_ns / NS_PER_S:.1f} s, "
                "though its input went on"
            )
        for stage, count in metrics.negative().items():
            found.append(f"{stream.name}: {count} latencies below 0 ({stage})")
    for row in collector.topology.haptics:
        receiver = collector.process(row.receiver)
        heard_ns = signals_ns[row.direction.receiver.value]
        long_enough = min(whole_ns, heard_ns) >= silence.MISSED_NS + delay_ns
        both = topology.alone is None
        if both and long_enough and receiver.total(SamplesReceived).received == 0:
            found.append(f"haptic_{row.key}: no sample was received")
        sender = collector.process(row.sender)
        for name in ("", *setup.more_axes):
            port = sender.total(PortMetrics, name)
            # One count of energy in a sample is rounding.
            if port.least_uj < -1:
                found.append(
                    f"{row.sender}: its port {name}".rstrip()
                    + f" gave out {-port.least_uj} µJ that the peer had not granted"
                )
    joystick = collector.process(JOYSTICK).find(JoystickMetrics)
    if joystick is not None and joystick.state.endswith("error"):
        found.append(f"joystick: {joystick.state}: {joystick.reason}")
    robot = collector.process(ROBOT).find(RobotMetrics)
    if robot is not None and robot.error:
        found.append(f"robot: {robot.error}")
    found += [str(one) for one in silence.silences(collector) if one.own and one.fault]
    taken = {stream.name for stream in setup.streams if silence.taken_by_page(stream, collector)}
    found += disagreements(sync, unjudged=taken)
    for process, reported in collector.processes.items():
        if lacks_room(reported.last_error or ""):
            found.append(f"{process}: {reported.last_error}")
        dropped = reported.total(ProbeMetrics).probe_values_dropped
        if dropped:
            found.append(f"{process}: {dropped} values for this report were lost")
    return found
