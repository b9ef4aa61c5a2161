"""What streams show now; those that show nothing, and inputs that deliver nothing."""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from kontur_av.meters import RateMeter
from kontur_av.sources.source import FILLED_BY_OTHERS
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.staleness import State
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics
from pipelines.report.collector import Collector
from pipelines.session.probe import FLUSH_NS
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import VOICE_PACKETS_PER_S, Setup, VideoStream, VoiceStream
from telepresence.link.link_metrics import ReceiverMetrics

#: A picture or a sound is missed if it does not come for this long and this many periods.
MISSED_NS = 2 * NS_PER_S
_MISSED_PERIODS = 4
_FOR_EVER_NS = 1 << 62
#: If the radio loses a larger share of the frames, hardly a picture comes whole.
_SPOILED = 0.05
#: Two ends that can hear each other meet within this time, also after restarts.
_MEET_NS = 10 * NS_PER_S
_STEP_NS = NS_PER_S
#: Why an input waits whose source is browser pages alone.
NO_PAGE = "no page gives it"


@dataclass(frozen=True)
class Silence:
    """An input that delivers nothing.

    process: of the input. fault: the last one of its source. waits: it has no source but browser
    pages, and none gives it anything: nothing is wrong. own: of a file or a user's class.
    """

    process: str
    sense: str
    silent_ns: int
    fault: str
    waits: bool = False
    own: bool = False

    def __str__(self) -> str:
        line = f"{self.process}: no {self.sense} for {self.silent_ns / NS_PER_S:.0f} s"
        return f"{line} ({self.fault})" if self.fault else line


def silences(collector: Collector, now_ns: int | None = None) -> list[Silence]:
    """The inputs that have delivered nothing for too long by `now_ns`, or by their last report."""
    setup = collector.setup
    found = []
    for name in setup.inputs:
        process = collector.topology.input(name).process
        metrics = collector.process(process)
        silent_ns = metrics.silent_ns(now_ns)
        video = setup.kind_of(name) == "video"
        if silent_ns >= _missed_ns(setup.stream_of(name).fps if video else VOICE_PACKETS_PER_S):
            waits = setup.source(name) in FILLED_BY_OTHERS
            fault = NO_PAGE if waits else metrics.capture.source_fault or ""
            sense = "picture" if video else "sound"
            own = fault.startswith(f"{setup.source(name)}: ")
            found.append(Silence(process, sense, silent_ns, fault, waits, own))
    return found


def waits_for_page(stream: VideoStream | VoiceStream, collector: Collector) -> bool:
    """Whether a stream's inputs have no source but browser pages, and none has given anything."""
    inputs = _chosen_inputs(stream, collector)
    return all(
        collector.setup.source(name) in FILLED_BY_OTHERS
        and collector.process(collector.topology.input(name).process).capture.captured_ns is None
        for name in inputs
    )


def taken_by_page(stream: VideoStream | VoiceStream, collector: Collector) -> bool:
    """Whether a browser page has given anything for an input of a stream."""
    topology = collector.topology
    processes = [row.process for row in topology.inputs if row.stream == stream.name]
    counters = [collector.process(name).total(CaptureMetrics) for name in processes]
    return any(each.from_page for each in counters)


def missed_ns(stream: VideoStream | VoiceStream) -> int:
    """The time (ns) after which a picture or a sound of `stream` is missed."""
    return _missed_ns(stream.fps if isinstance(stream, VideoStream) else VOICE_PACKETS_PER_S)


def _missed_ns(fps: float) -> int:
    return max(MISSED_NS, round(_MISSED_PERIODS * NS_PER_S / fps))


def signal_ns(segment: str, collector: Collector) -> int:
    """How long the gateway of `segment` had heard the other one without a pause at its last report.

    Very large if no gateway has reported its contacts; 0 if the radio has lost so many frames that
    hardly a picture can have come whole, or if fades often end the lock now, near the horizon.
    """
    metrics = collector.gateway(Segment(segment))
    link = metrics.newest_link
    if link is None:
        return _FOR_EVER_NS
    supervision, heard = link.supervision, link.receive
    if not supervision.signal or _spoiled(heard):
        return 0
    acquired_ns = supervision.begun_ns + supervision.contacts[-1].acquired_ns
    ran_ns, setup = metrics.told_ns - supervision.begun_ns, collector.topology.setup
    if _usable_ns(ran_ns, setup) <= _usable_ns(ran_ns - _STEP_NS, setup):
        return 0
    return metrics.told_ns - acquired_ns


def met_ns(segment: Segment, collector: Collector) -> int:
    """The longest time for which `segment` has heard the other end; else as of `signal_ns`."""
    now_ns, link = signal_ns(segment.value, collector), collector.gateway(segment).newest_link
    if link is None or _spoiled(link.receive):
        return now_ns
    ran_ns = collector.gateway(segment).told_ns - link.supervision.begun_ns
    ended = [one for one in link.supervision.contacts if one.lost_ns is not None]
    longest_ns = max(((one.lost_ns or 0) - one.acquired_ns for one in ended), default=0)
    return max(now_ns, min(longest_ns, _usable_ns(ran_ns, collector.topology.setup)))


def _spoiled(heard: ReceiverMetrics) -> bool:
    return heard.frames_lost > _SPOILED * (heard.frames_received + heard.frames_lost)


def is_blind(collector: Collector) -> bool:
    """Whether no picture of any stream was shown."""
    videos = (one.name for one in collector.setup.streams if isinstance(one, VideoStream))
    return not any(collector.shown(name).frames_displayed for name in videos)


def why_nothing(stream: VideoStream | VoiceStream, collector: Collector) -> str:
    """Return how far a stream of which nothing was displayed has come, with the mend, in words."""
    row = collector.topology.media(stream.name)
    inputs = [collector.topology.input(name) for name in _chosen_inputs(stream, collector)]
    gave = [collector.process(one.process).capture for one in inputs]
    if all(one.captured_ns is None for one in gave):
        waits = waits_for_page(stream, collector)
        why = NO_PAGE if waits else next((one.source_fault for one in gave if one.source_fault), "")
        names = " and ".join(one.name for one in inputs)
        return f"{names} gave nothing{why and f' ({why})'}: look at its source, or take another one"
    if not collector.process(row.sender).total(SenderCounts).frames_sent:
        return f"nothing was sent: look at {row.sender}"
    if not collector.received(stream.name).rtp_packets:
        return "nothing that was sent arrived: look at the link"
    return f"what arrived was not shown: look at {row.receiver} and {row.display}"


def never_met(collector: Collector, seconds: float) -> list[str]:
    """Each gateway here that has not met the other one, and why, although it should have."""
    found: list[str] = []
    # Without an application's data no connection is approved.
    for segment in () if collector.topology.options.bypass else collector.topology.segments:
        link = collector.gateway(segment).newest_link
        if link is None or seconds * NS_PER_S < _MEET_NS:
            continue
        supervision = link.supervision
        met = any(contact.connected_ns is not None for contact in supervision.contacts)
        if met or supervision.in_state_ns.get("connected"):
            continue
        usable_ns = _usable_ns(round(seconds * NS_PER_S), collector.topology.setup)
        if usable_ns >= _MEET_NS:
            why = supervision.why or "no frame of it came"
            found.append(
                f"{segment.value}: never met the other end in {seconds:.0f} s: {why}; look at its "
                "address, and at the keys of both (`kontur-av keys`)"
            )
    return found


def _usable_ns(until_ns: int, setup: Setup) -> int:
    """For how long the radio could be used from the beginning of the session until then."""
    radio = setup.radio_profile
    windows = radio.contact_windows()
    if windows is None:
        return until_ns
    if windows.usable_from_s is None or windows.usable_to_s is None:
        return 0
    begin_s = max(windows.usable_from_s - radio.start_s, 0.0)
    end_s = min(windows.usable_to_s - radio.start_s, until_ns / NS_PER_S)
    return max(0, round((end_s - begin_s) * NS_PER_S))


def stopped_ns(stream: VideoStream | VoiceStream, collector: Collector) -> int:
    """How long (ns) a stream has shown nothing while its input delivered; 0 if it never showed."""
    shown_ns = collector.streams[stream.name].pauses.last_ns
    if shown_ns is None:
        return 0
    if stream.name == collector.setup.uplink_video.name:
        shown_ns = max(shown_ns, collector.process("selector").selected_ns)
    longest_ns = 0
    for name in _chosen_inputs(stream, collector):
        metrics = collector.process(collector.topology.input(name).process)
        captured_ns = metrics.capture.captured_ns
        if captured_ns is not None:
            given_ns = captured_ns - max(shown_ns, metrics.gives_since_ns)
            longest_ns = max(longest_ns, given_ns)
    return longest_ns


def _chosen_inputs(stream: VideoStream | VoiceStream, collector: Collector) -> tuple[str, ...]:
    """The inputs of a stream; of the uplink's picture, those of the selected camera."""
    if stream.name != collector.setup.uplink_video.name:
        return collector.topology.media(stream.name).inputs
    camera = collector.process("selector").selected or collector.setup.cameras[0]
    return collector.topology.camera(camera).inputs


#: Figures are at most this old: a process reports twice a second, and may be late.
_TOLD_AFTER_NS = 2 * FLUSH_NS


def last_bps(rate: RateMeter, now_ns: int) -> float:
    """The rate of the last second that the processes have reported."""
    return rate.last_bps(now_ns - _TOLD_AFTER_NS)


def shown_now(
    stream: VideoStream | VoiceStream, collector: Collector, now_ns: int
) -> tuple[State, int | None]:
    """The state of what is shown of `stream`, and its age in ns.

    None: nothing was shown yet, or its clock is not known.
    """
    display = collector.process(collector.topology.media(stream.name).display)
    reported = display.total(DisplayMetrics, stream.name)
    if reported.age_ns is None:
        return reported.state, None
    age_ns = reported.age_ns + max(0, now_ns - display.told_ns - _TOLD_AFTER_NS)
    if age_ns >= collector.setup.stale_after_ns(stream):
        return State.STALE, age_ns
    return reported.state, age_ns
