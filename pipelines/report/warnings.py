"""What made a session worse than necessary, and its fix. A core.

A failure is a broken promise of the project. A warning is about the machine or the setup: a person
can change something.
"""

from collections.abc import Iterable, Mapping

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.sources.source import FILLED_BY_OTHERS
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.voice_receiver import LoudspeakerCounts
from pipelines.media.media_metrics import CaptureMetrics
from pipelines.report.collector import Collector
from pipelines.report.model import Warning
from pipelines.session.session_metrics import LEFT_OUT_SHARE, LoopMetrics
from pipelines.session.session_switch import lacks_room
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import VideoStream
from pipelines.session.topology.rows import LOOP_PRIORITY
from telepresence.link.link_metrics import PeerMetrics

#: A loop is late if its cycles begin later than this, at the 99th percentile.
LATE_NS = NS_PER_MS // 2
#: At least this share of the captured pictures must be shown.
SHOWN_SHARE = 0.8
#: Pictures are judged only with a signal for this share of the session, and with at most this
#: share of the frames lost.
_SIGNAL_SHARE, _LOST_SHARE = 0.95, 0.01
#: A shorter session says nothing about its pictures.
_LEAST_NS = 3 * NS_PER_S
#: From this round trip on, a first press is often felt too soft without a rendered wall.
_LONG_TRIP_NS = 100 * NS_PER_MS

_NO_REAL_TIME = "allow real-time priority: `kontur-av doctor` says how"
TOO_BUSY = "more than half a core: it goes on without real-time priority"
_TOO_SLOW = "use fewer cameras, or a faster machine"


def find_warnings(
    collector: Collector,
    *,
    seconds: float,
    restarts: Mapping[str, int],
    media: bool = True,
) -> list[Warning]:
    """The warnings of a session of `seconds`, in the order of its processes, then its streams.

    restarts: of each process that ran. media: False if the session had no streams.
    """
    topology = collector.topology
    found = []
    for name, count in restarts.items():
        found += find_loop_warnings(collector, name)
        if collector.process(name).scheduler == "too_busy":
            found.append(
                Warning(
                    what="priority_given_up",
                    where=name,
                    measured=TOO_BUSY,
                    fix=f"take smaller pictures, {_TOO_SLOW}",
                )
            )
        if count:
            last_error = collector.process(name).last_error or ""
            found.append(restart_warning(name, count, last_error))
    free = _free_channel(collector, seconds)
    for stream in collector.setup.streams if media else ():
        if isinstance(stream, VideoStream) and free:
            found += picture_warnings(
                stream.name,
                fps=stream.fps,
                seconds=seconds,
                captured=_captured(stream.name, collector),
                refused=collector.process(topology.media(stream.name).sender)
                .total(SenderCounts)
                .frames_refused,
                # What another machine shows is not known here.
                displayed=collector.shown(stream.name).frames_displayed
                if topology.alone is None
                else None,
            )
    for row in topology.processes_here:
        played = collector.process(row.name).find(LoudspeakerCounts)
        if played is not None and played.play_fault:
            fix = "choose another loudspeaker in [playback] of the setup, or leave it out"
            words = f"its loudspeaker does not play: {played.play_fault}"
            found.append(Warning(what="playback", where=row.name, measured=words, fix=fix))
    found += hand_warnings(collector)
    return [*found, *find_path_warnings(collector, topology.segments)]


def hand_warnings(collector: Collector) -> list[Warning]:
    """A warning for a direct hand at a long round trip, where a rendered wall is felt better."""
    setup, topology = collector.setup, collector.topology
    if setup.hand in ("auto", "mediated") or setup.partner_arm in ("shared", "board"):
        return []
    if topology.alone is None:
        ways = [collector.haptics[way].latency for way in ("down", "up")]
        trip_ns = sum(way.percentile(50) for way in ways) if all(way.count for way in ways) else 0
    else:
        # The other machine's clock is known to half of the shortest round trip.
        link = collector.gateway(Segment.SPACE).link
        clock = None if link is None else link.clock
        trip_ns = 2 * (0 if clock is None else clock.error_ns or 0)
    if trip_ns < _LONG_TRIP_NS:
        return []
    measured = f"the hand felt forces after a round trip of {trip_ns / NS_PER_MS:.0f} ms"
    fix = "take `--hand auto`, which renders walls from the start: docs/haptics.md"
    return [Warning(what="hand_direct", where="joystick", measured=measured, fix=fix)]


def find_path_warnings(collector: Collector, segments: Iterable[Segment]) -> list[Warning]:
    """A warning for each of these ends whose path to another machine is not protected.

    So is one whose frames came, but whose peer's clock never was known.
    """
    found = []
    for segment in segments:
        gateway, metrics = collector.topology.gateway(segment).name, collector.gateway(segment)
        peer = metrics.find(PeerMetrics)
        if peer is not None and not peer.protected:
            found.append(
                Warning(
                    what="not_protected",
                    where=gateway,
                    measured="anybody on the path could read, change and steer",
                    fix="leave --insecure out at both ends: `kontur-av keys new`",
                )
            )
        clock = None if metrics.link is None else metrics.link.clock
        if clock is not None and clock.offset_ns is None and clock.messages_received:
            found.append(
                Warning(
                    what="clock_unknown",
                    where=gateway,
                    measured=f"{clock.messages_received} messages of the peer's clock fit no clock",
                    fix="ages and latencies between the machines are not known: install the same "
                    "version at both ends, and let nothing step their clocks",
                )
            )
    return found


def find_loop_warnings(collector: Collector, process: str) -> list[Warning]:
    if collector.topology.process(process).priority != LOOP_PRIORITY:
        return []
    metrics = collector.process(process)
    loop = metrics.total(LoopMetrics)
    return loop_warnings(
        process,
        cycles=loop.cycles,
        left_out=loop.slips,
        late_ns=round(metrics.lateness.percentile(99)) if metrics.lateness.count else 0,
        scheduler=metrics.scheduler or "",
    )


def loop_warnings(
    process: str, *, cycles: int, left_out: int, late_ns: int, scheduler: str
) -> list[Warning]:
    """Whether a loop of 1 kHz left out too much, or was late.

    cycles: done. late_ns: 99th percentile. scheduler: `fifo` with real-time priority.
    """
    fix = _TOO_SLOW if scheduler == "fifo" else _NO_REAL_TIME
    share = left_out / max(1, cycles + left_out)
    if share > LEFT_OUT_SHARE:
        measured = f"{100 * share:.1f} % of its cycles were left out"
        return [Warning(what="cycles_left_out", where=process, measured=measured, fix=fix)]
    if late_ns > LATE_NS:
        measured = f"1 of 100 cycles began more than {late_ns / NS_PER_MS:.1f} ms late"
        return [Warning(what="cycles_late", where=process, measured=measured, fix=fix)]
    return []


def restart_warning(process: str, restarts: int, last_error: str) -> Warning:
    why = f": {last_error}" if last_error else ""
    fix = "fix what its error names; report an error of this software"
    if lacks_room(last_error):
        fix = "end the program that fills /dev/shm, or give more (--shm-size=256m)"
    times = "once" if restarts == 1 else f"{restarts} times"
    return Warning(
        what="restarted", where=process, measured=f"it was started again {times}{why}", fix=fix
    )


def picture_warnings(
    stream: str, *, fps: float, seconds: float, captured: int, refused: int, displayed: int | None
) -> list[Warning]:
    """Whether too few pictures were captured or shown over a free channel.

    captured: at the input; 0 if it delivered none, which another warning reports. refused: pictures
    that the cap had no room for. displayed: pictures that were shown; None: not known.
    """
    seconds = max(seconds, 1e-9)
    if not captured:
        return []
    if captured < SHOWN_SHARE * fps * seconds:
        measured = f"its input gave {captured / seconds:.1f} of {fps} pictures a second"
        fix = f"if the source gives more, {_TOO_SLOW}"
        return [Warning(what="few_captured", where=stream, measured=measured, fix=fix)]
    if displayed is not None and displayed < SHOWN_SHARE * (captured - refused):
        measured = (
            f"{displayed / seconds:.1f} pictures a second were shown of "
            f"{captured / seconds:.1f} captured"
        )
        return [Warning(what="few_shown", where=stream, measured=measured, fix=_TOO_SLOW)]
    return []


def _captured(stream: str, collector: Collector) -> int:
    """What the busiest input of a stream captured, without those that only pages fill."""
    inputs = (
        name
        for name in collector.topology.media(stream).inputs
        if collector.setup.source(name) not in FILLED_BY_OTHERS
    )
    processes = (collector.topology.input(name).process for name in inputs)
    return max(
        (collector.process(name).total(CaptureMetrics).captured for name in processes), default=0
    )


def _free_channel(collector: Collector, seconds: float) -> bool:
    """Whether the radio let nearly everything through in both directions, nearly all the time."""
    if seconds * NS_PER_S < _LEAST_NS:
        return False
    for segment in Segment:
        for link in collector.gateway(segment).links():
            heard = link.receive
            lost_share = heard.frames_lost / max(1, heard.frames_received + heard.frames_lost)
            signal_share = link.supervision.contact_ns / (seconds * NS_PER_S)
            if lost_share > _LOST_SHARE or signal_share < _SIGNAL_SHARE:
                return False
    return True
