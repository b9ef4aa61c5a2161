"""The reports of all commands, as types, and their one way to JSON and back.

What processes count is declared where it is counted, and a report holds those records themselves
(`kontur_av.metrics`). In JSON the figures of a `Flat` record stand among those of the report that
holds it. Declared here is what only a report says.

A `#:` comment above a field says what it is; the tables of the keys in docs/report.md are made from
these comments and from the names and types. A unit that ends a name holds for all values below it.
A field whose default is None is left out of the JSON when it has no value.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cache
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.metrics import Flat, is_flat
from kontur_av.report import Latency
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.streams.sent_stream import SentStream
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.video_sender import FeedbackCounts
from kontur_av.streams.voice_receiver import LoudspeakerCounts, VoiceReceiverCounts
from pipelines.link.link_metrics import SocketMetrics, WayInMetrics
from pipelines.media.media_metrics import CodingCosts, DisplayMetrics, GainMetrics
from pipelines.mission.mission_metrics import ComponentMetrics
from pipelines.partner.partner_metrics import RtcMetrics
from pipelines.recording.recorder_metrics import FoxgloveMetrics, RecorderMetrics
from pipelines.session.session_metrics import DatedEvent, LoopMetrics, Report
from pipelines.session.task_journal import TaskRow
from telepresence.haptics.authority import AuthorityMetrics
from telepresence.haptics.envelope import SafetyMetrics
from telepresence.haptics.haptic_metrics import (
    JoystickMetrics,
    OperationMetrics,
    PortMetrics,
    PressMetrics,
    RobotMetrics,
    SamplesReceived,
    SamplesSent,
)
from telepresence.link.link_metrics import (
    ChannelMetrics,
    ClockMetrics,
    ContactWindows,
    PathMetrics,
    PeerMetrics,
    ReceiverMetrics,
    SenderMetrics,
    SupervisionMetrics,
)

T = TypeVar("T")
#: What the receiving end of two knows; the rest is the sender's, or found anew (`join.py`).
RECEIVED = "received"
Received = Annotated[T, RECEIVED]


class Punctuality(Latency, frozen=True, kw_only=True):
    """How late a periodic task was."""

    p99_9: float = msgspec.field(name="p99.9")


class Spread(Punctuality, frozen=True, kw_only=True):
    """Percentiles of a duration by nearest rank in a histogram."""

    mean: float
    #: Number of values.
    count: int


class Stages(Report, frozen=True, kw_only=True):
    """Stages of a latency, of units whose every stage is known."""

    #: Capture, waiting for the encoder, and encoding.
    capture_to_encoded: Spread
    #: Pacing at the sender.
    encoded_to_sent: Spread
    #: Gateways, queues and radio, until the last packet has arrived.
    sent_to_received: Spread
    #: Decoding, playout, and the way to the display.
    received_to_displayed: Spread


class StreamLatency(Spread, frozen=True, kw_only=True):
    """The latency of a stream from capture to display."""

    stages: Stages


class StreamReport(SentStream, frozen=True, kw_only=True):
    """One media stream, from its input to its display."""

    #: The only side that ran here, `sender` or `receiver`; the other's counts are 0 or empty.
    side: str | None = None
    #: What samples left out added to the cap, on average.
    gained_bps: int | None = None
    gain: Flat[GainMetrics] | None = None
    #: By how much a sliding second exceeded the cap that held then.
    above_cap_bps: int = 0
    #: The rate of the last second; while the session runs.
    rate_bps: int | None = None
    #: Of pictures alone:
    feedback: Flat[FeedbackCounts] | None = None
    #: Of pictures alone:
    video: Received[Flat[VideoReceiverCounts]] | None = None
    #: Of a voice alone:
    voice: Received[Flat[VoiceReceiverCounts]] | None = None
    #: Of pictures alone:
    decoder: Received[Flat[DecoderCounts]] | None = None
    display: Received[Flat[DisplayMetrics]]
    #: Of a voice alone:
    playback: Received[Flat[LoudspeakerCounts]] | None = None
    displayed_hz: Received[float]
    stale_after_ms: Received[float]
    #: From capture to display; of one end alone without its stages.
    latency_ms: StreamLatency
    #: The newest latency; while the session runs.
    newest_ms: float | None = None
    #: Error of every latency, as two machines took its stamps.
    latency_error_ms: float | None = None
    #: Begin and end of each time over 1 s without anything displayed, in session time.
    pauses_s: list[tuple[float, float]]
    #: Largest error of the capture time that travelled by RTCP.
    capture_stamp_error_us: float

    @property
    def rtp(self) -> ReceiverCounts:
        came = self.video or self.voice
        return ReceiverCounts() if came is None else came.rtp


class HapticReport(Report, frozen=True, kw_only=True):
    """One direction of the haptic samples: `up` carries forces, `down` carries motion."""

    side: str | None = None
    #: The rate of the insert zone.
    cap_bps: int
    #: The rate of received samples.
    payload_bps_mean: Received[int]
    #: The same of the last second; while the session runs.
    rate_bps: Received[int] | None = None
    sender: Flat[SamplesSent]
    #: The rate that samples left out saved.
    saved_bps: int | None = None
    receiver: Received[Flat[SamplesReceived]]
    #: From one end's loop to the other's.
    latency_ms: Spread
    #: Samples received whose instant of sending never became known.
    unmatched: Received[int]
    #: Begin and end of each time over 0.2 s without a sample, in session time.
    pauses_s: list[tuple[float, float]]
    #: How late the sender's cycles of 1 ms began.
    lateness_us: Punctuality
    #: Cycles of the sender.
    loop: Flat[LoopMetrics]
    #: The haptic port at the sender, and its passivity controller.
    port: PortMetrics
    #: The same of each axis behind x and y.
    axes: dict[str, PortMetrics] | None = None
    #: How hard the robot presses; of the joystick's end.
    press: PressMetrics | None = None


class NeedReport(Report, frozen=True, kw_only=True):
    """What a direction needs with every stream at its cap."""

    payload: int
    headers: int
    #: For RTCP, feedback and supervision.
    reserve: int
    #: What is left.
    spare: int


class LineReport(Report, frozen=True, kw_only=True):
    """One line of that arithmetic."""

    what: str
    #: The stream it is for, if any.
    stream: str
    bps: int


class DirectionReport(Report, frozen=True, kw_only=True):
    """One direction of the link, of all starts of its two gateways."""

    #: What is left below haptics.
    below_haptics_bps: int
    #: The need at the caps.
    needed_at_caps_bps: NeedReport
    #: The same, line by line.
    arithmetic: list[LineReport]
    sender: Flat[SenderMetrics]
    receiver: Received[Flat[ReceiverMetrics]]
    #: Mean rate that slots without a sample freed.
    freed_bps: int
    #: Shares of all octets sent.
    octets_percent: dict[str, float]
    #: How late slots began.
    lateness_us: Punctuality
    #: From a slot's deadline until its frame had been sent.
    sent_after_us: Punctuality
    #: Slots of the sender.
    loop: Flat[LoopMetrics]


class GatewayReport(Report, frozen=True, kw_only=True):
    """One end of the link: its link of the last start, its sockets of all starts."""

    supervision: SupervisionMetrics | None = None
    #: What the radio did to the frames of this end.
    radio: PathMetrics | None = None
    sockets: Flat[SocketMetrics]
    #: Of two machines only.
    peer: PeerMetrics | None = None
    #: Of two machines only.
    clock: ClockMetrics | None = None
    #: The radio on the way in; only where `--trainer` put both directions at this end.
    way_in: Flat[WayInMetrics] | None = None

    @property
    def channel(self) -> ChannelMetrics | None:
        return None if self.radio is None else self.radio.channel

    @property
    def contact(self) -> ContactWindows | None:
        return None if self.channel is None else self.channel.contact


class SkewReport(Report, frozen=True, kw_only=True):
    """How much later the first of two senses came."""

    p50: float
    p95: float
    p99: float
    #: The one farthest from zero.
    max: float
    count: int


class Terms(Report, frozen=True, kw_only=True):
    """What a latency is made of: means of terms, which add up."""

    camera: float
    capture: float
    encoding: float
    queueing: float
    serialisation: float
    propagation: float
    decoding: float
    display: float
    total: float


class VideoLead(Report, frozen=True, kw_only=True):
    """How much earlier the force of an event comes than its picture."""

    #: Pictures of which every term is known.
    pictures: int
    #: The mean size of a picture in RTP payload.
    octets_mean: float
    #: What haptic samples leave of the channel.
    zone_bps: int
    #: From the event to its picture.
    video_ms: Terms
    #: From the event to its force.
    force_ms: Terms
    #: The difference.
    lead_ms: Terms


class Ranks(Report, frozen=True, kw_only=True):
    """Percentiles of few signed values by nearest rank; empty without values."""

    p50: float | None = None
    p95: float | None = None
    p99: float | None = None
    #: The one farthest from zero.
    max: float | None = None


class SenseReport(Report, frozen=True, kw_only=True):
    """What one sense of the operator perceived of the contacts."""

    stream: str
    perceived: int
    missed: int
    #: From the contact to its perception.
    latency_ms: Ranks
    #: The same by the stamps that travelled with the stream.
    stamped_latency_ms: Ranks
    #: The captured instant by the stamps, less the contact's.
    stamp_error_ms: Ranks
    #: The clearest perceptions, by which the stamps are judged.
    judged: int
    #: Their median error.
    judged_error_ms: float | None
    #: Its interval of 95 % confidence.
    confident_ms: tuple[float, float] | None
    #: Where it may lie.
    allowed_error_ms: tuple[float, float]
    #: Whether stamps and content agree; null: too few.
    agrees: bool | None
    #: Lights, clicks or steps found, also those of no contact.
    found: int


class ContentSkew(Report, frozen=True, kw_only=True):
    """How much later the first of two senses perceived a contact."""

    #: Contacts that both perceived.
    events: int
    p50: float
    p95: float
    p99: float
    #: The one farthest from zero.
    max: float
    #: The share, from 0 to 1, that people do not notice.
    within: float
    #: What people do not notice.
    limits_ms: tuple[float, float]
    #: Who says so.
    source: str


class ListedContact(Report, frozen=True, kw_only=True):
    """One contact, with the latency of each sense; null where it was not perceived."""

    #: Since the first contact.
    at_s: float
    #: The LED that was touched.
    led: int
    light_ms: float | None
    click_ms: float | None
    force_ms: float | None


class SyncReport(Report, frozen=True, kw_only=True):
    """Contacts with the task board, and what was seen, heard and felt of them."""

    #: Contacts with a target.
    events: int
    touches_beside_targets: int
    #: Contacts that followed another one at once.
    bounces: int
    #: `light`, `click`, `force`; null for a sense that none reaches.
    senses: dict[str, SenseReport | None]
    #: By pair of senses; null if no contact has both.
    skew_ms: dict[str, ContentSkew | None]
    #: The newest 1000 contacts.
    listed: list[ListedContact]


class LipSyncReport(Report, frozen=True, kw_only=True):
    """Shares of the time, from 0 to 1, by the limits of ITU-R BT.1359."""

    within: float
    #: Sound too early.
    early: float
    #: Sound too late.
    late: float


class CpuReport(Report, frozen=True, kw_only=True):
    """CPU time of the launcher and of all processes."""

    total_s: float
    launcher_s: float
    #: CPU seconds a second.
    cores_used: float


class ProcessReport(Report, frozen=True, kw_only=True):
    """One process, over all its starts."""

    #: The newest values of what it tells and what does not add up.
    newest: Flat[dict[str, int | float | str | bool]]
    cpu_s: float
    #: Times that it was started again.
    restarts: int
    #: The last fault of an input's source.
    source_fault: str | None = None
    #: `fifo`: with real-time priority; `too_busy`: without, it took more than half a core; `idle`:
    #: behind all others; or `other`.
    scheduler: str | None = None
    #: Why it last ended unasked.
    last_error: str | None = None
    #: Since when an input has given nothing.
    silent_s: float | None = None
    #: What it counted.
    counts: dict[str, int] | None = None


class Warning(Report, frozen=True, kw_only=True):
    """What made the session worse than need be."""

    #: Which kind: see `pipelines.report.warnings`.
    what: str
    #: The process or stream.
    where: str
    #: What was measured, in words.
    measured: str
    #: What fixes it.
    fix: str


class ReplayedStream(Report, frozen=True, kw_only=True):
    """Pictures of a replayed stream, against the recording's.

    A live replay has the first of them only.
    """

    #: Access units in the recording, as sent.
    units_recorded: int
    #: Of these, arrived whole; 0 if they were coded anew.
    units_received: int | None = None
    #: Of these, arrived whole in the recorded session.
    recorded_received: int | None = None
    #: Arrived alike, octet by octet, in both.
    same_received: int | None = None
    #: Decoded pictures that equal what was sent.
    pictures_same: int | None = None
    #: PSNR of the luma of all decoded pictures against those sent, at most 99.
    psnr_db_mean: float | None = None
    #: The worst twentieth lies below.
    psnr_db_p5: float | None = None


class ReplayReport(Report, frozen=True, kw_only=True):
    """A recording that was sent again."""

    #: The recorded session.
    session: str
    #: The seed of its radio.
    recorded_seed: int
    #: Seconds of the recording a second.
    speed: float
    #: Whether the pictures were coded anew.
    recoded: bool
    #: By stream of pictures.
    streams: dict[str, ReplayedStream]
    #: Haptic samples not sent for a newer one of the same cycle; on virtual time.
    samples_superseded: int | None = None
    #: By channel: messages that the recording lacks.
    missing: dict[str, int]


class SimulationReport(Report, frozen=True, kw_only=True):
    """The inputs of this simulation."""

    seed: int
    radio: str
    media: bool
    #: The robot's name; sim for the simulated one.
    robot: str
    costs: CodingCosts


class SecondArmReport(Report, frozen=True, kw_only=True):
    """The arm that only a partner drives (docs/webrtc.md)."""

    sender: Flat[SamplesSent]
    receiver: Flat[SamplesReceived]
    port: Flat[PortMetrics]


class RtcShownReport(Report, frozen=True, kw_only=True):
    """What was shown or heard of a partner."""

    #: Pictures, or blocks of 20 ms of voice.
    display: Flat[DisplayMetrics]
    #: From capture to display, above the network's least delay of the last 30 s: the partner's
    #: clock is unknown.
    latency_ms: Spread


class RtcReport(Report, frozen=True, kw_only=True):
    """The leg to a partner across the Internet."""

    metrics: Flat[RtcMetrics]
    #: By stream of `metrics`.
    mean_bps: dict[str, int]
    #: `rtc_camera` and `rtc_voice`.
    shown: dict[str, RtcShownReport]


class TraceBlock(Report, frozen=True, kw_only=True):
    """Rows of integers, packed (`pipelines.report.trace`)."""

    rows: int
    #: Base64.
    octets: str


class TraceSeries(Report, frozen=True, kw_only=True):
    """The rows of one kind that a process told."""

    process: str
    #: `Tx`, `Rx`, `Shown` and so on.
    kind: str
    #: Their stream; empty if the process says it.
    stream: str
    blocks: list[TraceBlock]


class EndTrace(Report, frozen=True, kw_only=True):
    """What `report join` needs of an end."""

    #: The setup, as TOML.
    setup: str
    #: Unix time minus the clock of all instants here.
    wall_offset_ns: int
    #: When the end began to run.
    began_ns: int
    ended_ns: int
    #: Lives of this end's gateway; `peers`: those it met.
    lives: list[int]
    peers: list[int]
    series: list[TraceSeries]


class SessionReport(Report, frozen=True, kw_only=True):
    """The report of `stream`, `replay` and `simulate`."""

    setup: str
    #: The only end that ran here, `ground` or `space`; what the other knows is 0, empty or null.
    end: str | None = None
    #: How long the session ran. Mean rates are over the time outside of `stopped_s`.
    seconds: float
    #: Begin and end of each stop by ground control.
    stopped_s: list[tuple[float, float]] | None = None
    streams: dict[str, StreamReport]
    #: `up` and `down`.
    haptic: dict[str, HapticReport]
    #: A real joystick; null with the simulated one.
    joystick: JoystickMetrics | None
    #: `uplink` and `downlink`.
    link: dict[str, DirectionReport]
    #: `ground` and `space`, those that ran here.
    gateways: dict[str, GatewayReport]
    #: At the operator, by stamps: `video_haptic`, `audio_haptic`, `audio_video`; null without any.
    skew_ms: dict[str, SkewReport | None]
    #: Where the time of the uplink's picture went; null without pictures.
    video_lead: VideoLead | None
    #: At the operator, by content; null if nothing was touched.
    sync: SyncReport | None
    #: How long sound and picture were together; null without both.
    lip_sync: LipSyncReport | None
    cpu: CpuReport
    processes: dict[str, ProcessReport]
    #: What broke a promise: a cap exceeded, a stream or haptics stopped despite a signal, a wrong
    #: stamp, energy made, a joystick or robot failed, values of this report lost. Also a process
    #: that hung, did not come up, was started again more than twice, or ended without a reason.
    failures: list[str]
    #: What made the session worse than need be, and its fix.
    warnings: list[Warning]
    #: Who drove the robot; only where a partner may, too.
    arm: AuthorityMetrics | None = None
    #: What let the robot follow the hand or held it; of the robot's end.
    safety: SafetyMetrics | None = None
    #: The robot; of its end.
    robot: RobotMetrics | None = None
    #: The arm that only a partner drives.
    second_arm: SecondArmReport | None = None
    #: What the trainer did, oldest first.
    exercises: list[DatedEvent] | None = None
    #: Which part of the uplink's picture people wanted finest, oldest first.
    focus: list[DatedEvent] | None = None
    #: The recording.
    recorder: RecorderMetrics | None = None
    #: Clients of `--foxglove`.
    foxglove: FoxgloveMetrics | None = None
    #: The leg to a partner.
    rtc: RtcReport | None = None
    #: The runs of tasks, oldest first; only with a plan.
    tasks: list[TaskRow] | None = None
    #: Components in telemetry.
    telemetry: dict[str, ComponentMetrics] | None = None
    #: What `report join` needs; of one end alone.
    trace: EndTrace | None = None
    #: Of `simulate` only.
    simulation: SimulationReport | None = None
    #: Of a replay only.
    replay: ReplayReport | None = None

    @property
    def running_s(self) -> float:
        """How long it ran without being stopped."""
        return self.seconds - sum(end_s - begin_s for begin_s, end_s in self.stopped_s or ())


class LinkRadio(Report, frozen=True, kw_only=True):
    """The radio of `link`."""

    profile: str
    seed: int


class LinkReport(Report, frozen=True, kw_only=True):
    """The report of `link`. With one end alone it lacks what the other end counts."""

    setup: str
    seconds: float
    ends: list[str]
    radio: LinkRadio
    #: `uplink` and `downlink`.
    link: dict[str, DirectionReport]
    #: By end.
    gateways: dict[str, GatewayReport]
    cpu: CpuReport
    processes: dict[str, ProcessReport]
    #: Any gives exit code 1.
    failures: list[str]
    warnings: list[Warning]


class FigureReport(Report, frozen=True, kw_only=True):
    """One measured quantity of a functional check, with its limits."""

    name: str
    #: Null when it could not be measured.
    value: float | None
    unit: str
    #: Null for no limit on this side.
    least: float | None
    most: float | None
    passed: bool


class CheckReport(Report, frozen=True, kw_only=True):
    """One functional check of a joystick."""

    name: str
    #: Null for a check that was skipped.
    passed: bool | None
    #: Why it ended early; empty if it did not.
    trouble: str
    #: What the device lacks for it; empty if nothing.
    skipped: str
    metrics: list[FigureReport]


class TransitionReport(Report, frozen=True, kw_only=True):
    """One transition of the joystick's state machine."""

    #: Since the test began; null in real time.
    s: float | None
    #: The state before, in words.
    before: str
    event: str
    #: The state after, in words.
    after: str
    reason: str


class JoystickTestReport(Report, frozen=True, kw_only=True):
    """The report of `joystick test`."""

    #: SPEC of the joystick.
    device: str
    virtual_time: bool
    seconds: float
    #: Whether every check was done, and none failed.
    passed: bool
    checks: list[CheckReport]
    joystick: OperationMetrics
    transitions: list[TransitionReport]


AnyReport = TypeVar("AnyReport", bound=Report)


@cache
def keys_of(kind: Any) -> tuple[tuple[str, str, bool, bool], ...]:
    """Of each field of a record: its name, its key, whether it may be left out, and is flat."""
    if issubclass(kind, msgspec.Struct):
        rows = [
            (one.name, one.encode_name, one.default is None) for one in msgspec.structs.fields(kind)
        ]
    else:
        rows = [(one.name, one.name, one.default is None) for one in dataclasses.fields(kind)]
    return tuple((name, key, optional, is_flat(kind, name)) for name, key, optional in rows)


def to_builtins(report: Any) -> Any:
    """A report, or what holds some, as tables, lists, strings and numbers."""
    if isinstance(report, str | int | float | None) and not isinstance(report, Enum):
        return report
    if isinstance(report, Mapping):
        return {key: to_builtins(value) for key, value in report.items()}
    if isinstance(report, list | tuple):
        return [to_builtins(one) for one in report]
    if isinstance(report, Enum):
        return report.value
    found: dict[str, object] = {}
    kind: Any = type(report)
    for name, key, optional, flat in keys_of(kind):
        value = getattr(report, name)
        if flat:
            found |= {} if value is None else to_builtins(value)
        elif value is not None or not optional:
            found[key] = to_builtins(value)
    return found


def to_json(report: object) -> str:
    """A report, or what holds some, as text indented by two, with a newline at its end."""
    return json.dumps(to_builtins(report), indent=2) + "\n"


def from_json(text: str | bytes, kind: type[AnyReport]) -> AnyReport:
    """The report in `text`; msgspec.ValidationError if it is not of this `kind`."""
    return msgspec.convert(_nested(msgspec.json.decode(text), kind), kind)


def _nested(found: Any, hint: Any) -> Any:
    """What JSON has, with a table of its own for each flat record."""
    hint = _type_of(hint)
    arguments = get_args(hint)
    if isinstance(found, list) and (get_origin(hint) is list or Ellipsis in arguments):
        return [_nested(one, arguments[0]) for one in found]
    if not isinstance(found, dict):
        return found
    if not _is_record(hint):
        return (
            {key: _nested(one, arguments[1]) for key, one in found.items()} if arguments else found
        )
    made: dict[str, object] = {}
    hints, rows = _hints_of(hint), keys_of(hint)
    for name, key, _, flat in rows:
        if flat and not _is_record(_type_of(hints[name])):
            own = {row[1] for row in rows if not row[3]}
            made[name] = {key: one for key, one in found.items() if key not in own}
        elif flat and _is_in(found, _type_of(hints[name])):
            made[name] = _nested(found, hints[name])
        elif not flat and key in found:
            made[key] = _nested(found[key], hints[name])
    return made


def _is_in(found: Mapping[str, Any], kind: type) -> bool:
    """Whether a table has a flat record of this kind: some of its keys, and all that must be."""
    known, required = _keys_in(kind)
    return required <= found.keys() and not found.keys().isdisjoint(known)


@cache
def _hints_of(kind: Any) -> Mapping[str, Any]:
    """The types of a record's fields; a report has hundreds of records of few kinds."""
    return get_type_hints(kind)


@cache
def _keys_in(kind: type) -> tuple[frozenset[str], frozenset[str]]:
    """All keys of a record, with those of the flat ones in it, and those that must be there."""
    keys = dict(_keys(kind))
    return frozenset(keys), frozenset(key for key, optional in keys.items() if not optional)


def _keys(kind: type) -> Iterator[tuple[str, bool]]:
    """The keys of a record, with those of the flat ones in it; whether each may be left out."""
    hints = _hints_of(kind)
    for name, key, optional, flat in keys_of(kind):
        if flat:
            below = _keys(_type_of(hints[name]))
            yield from ((one, optional or may) for one, may in below)
        else:
            yield key, optional


def _type_of(hint: Any) -> Any:
    if get_origin(hint) in (Union, UnionType):
        return next(arg for arg in get_args(hint) if arg is not type(None))
    return hint


def _is_record(kind: object) -> bool:
    return isinstance(kind, type) and (
        dataclasses.is_dataclass(kind) or issubclass(kind, msgspec.Struct)
    )
