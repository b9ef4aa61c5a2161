"""The reports of all commands, as types, and their one way to JSON and back.

A comment above a field says what it is; the table of the keys in docs/report.md is made from these
comments and from the names and types. A unit that ends a name holds for all values below it. A
field whose default is None is left out of the JSON when it has no value.
"""

import json
from typing import Any, TypeVar

import msgspec

from telepresence.haptics.figures import JoystickFigures, OperationFigures
from telepresence.link.figures import (
    ClockFigures,
    ContactWindows,
    QueueFigures,
    SupervisionFigures,
)


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What all parts of a report have in common."""


class Spread(Report, frozen=True, kw_only=True):
    """Percentiles of a duration by nearest rank in a histogram."""

    p50: float
    p95: float
    p99: float
    p99_9: float = msgspec.field(name="p99.9")
    max: float
    mean: float
    #: Number of values.
    count: int


class Stages(Report, frozen=True, kw_only=True):
    """The four stages of a stream's latency, of the units whose every stage is known."""

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


class StreamReport(Report, frozen=True, kw_only=True):
    """One media stream, from its input to its display."""

    #: The only side that ran here, `sender` or `receiver`; what the other one counts is 0 or empty.
    side: str | None = None
    #: The largest rate of RTP payload over any second.
    cap_bps: int
    #: What haptic samples that were left out added to the cap, on average.
    gained_bps: int | None = None
    #: How often that changed.
    gain_changes: int | None = None
    #: Width and height of what is captured and displayed; of pictures only.
    size: tuple[int, int] | None = None
    #: Width and height that are coded; of pictures only.
    coded_size: tuple[int, int] | None = None
    payload_bps_mean: int
    #: The largest rate over a sliding second.
    payload_bps_max_1s: int
    #: The largest rate over a sliding tenth of a second.
    payload_bps_max_100ms: int
    #: Pictures or blocks of sound that came to the sender.
    frames_captured: int
    frames_encoded: int
    frames_sent: int
    #: Pictures or blocks that the encoder's budget had no room for.
    frames_refused: int
    #: Pictures or blocks that were shown or played; concealed sound does not count.
    frames_displayed: int
    displayed_hz: float
    #: RTP packets received.
    rtp_packets: int | None = None
    #: Gaps in the sequence numbers.
    rtp_lost: int | None = None
    rtp_reordered: int | None = None
    rtp_duplicates: int | None = None
    #: Packets that came after their turn.
    rtp_late: int | None = None
    #: Datagrams that are no RTP of this stream.
    garbage: int | None = None
    #: Access units with gaps; of pictures only.
    frames_damaged: int | None = None
    #: Blocks that the decoder had to make up; of voices only.
    frames_concealed: int | None = None
    #: Blocks that were restored from forward error correction; of voices only.
    frames_recovered: int | None = None
    #: Access units that the decoder could not decode; of pictures only.
    frames_corrupt: int | None = None
    #: Units that came before a sender report gave their capture time.
    frames_undated: int | None = None
    #: Pictures of another size than the stream's; of pictures only.
    frames_oversized: int | None = None
    #: From this age on, what is shown counts as stale.
    stale_after_ms: float
    #: How long what was shown was stale.
    stale_ms: float
    stale_episodes: int
    #: How long the picture stood still; of pictures only.
    frozen_ms: float | None = None
    frozen_episodes: int | None = None
    #: How long the picture showed damage; of pictures only.
    damaged_ms: float | None = None
    damaged_episodes: int | None = None
    #: From capture to display; of one end alone without its stages.
    latency_ms: StreamLatency
    #: Every latency may be wrong by this, because two machines took its stamps.
    latency_error_ms: float | None = None
    #: From when to when nothing was displayed, each longer than 1 s, in seconds of the session.
    pauses_s: list[tuple[float, float]]
    #: The largest difference of the capture time that travelled by RTCP to the stamp itself.
    capture_stamp_error_us: float


class Punctuality(Report, frozen=True, kw_only=True):
    """How late a periodic task was."""

    p50: float
    p95: float
    p99: float
    max: float
    p99_9: float = msgspec.field(name="p99.9")


class PortReport(Report, frozen=True, kw_only=True):
    """Energies of the haptic port at the sender of a direction, and its passivity controller."""

    energy_in_uj: int
    energy_out_uj: int
    #: Cycles in which the passivity controller acted.
    passivity_acted: int
    #: Refused totals of the peer's energy.
    totals_refused: int
    #: Energy that this end may still give out.
    credit_uj: int | None = None
    #: The least that the passivity observer saw; below 0 energy was made.
    least_uj: int | None = None


class HapticReport(Report, frozen=True, kw_only=True):
    """One direction of the haptic samples: `up` carries forces, `down` carries motion."""

    #: The only side that ran here, `sender` or `receiver`; what the other one counts is 0 or empty.
    side: str | None = None
    #: The rate of the insert zone.
    cap_bps: int
    #: The rate of the samples that were received.
    payload_bps_mean: int
    sent: int
    #: Samples that the deadband left out.
    left_out: int | None = None
    #: The rate that this saved.
    saved_bps: int | None = None
    received: int
    lost: int
    #: Samples that came after a newer one.
    late: int
    #: Samples of another session, which are not used.
    strays: int
    #: Greetings that arrived in the place of samples.
    greetings: int
    #: Sessions that the receiver began; about one in 30 s.
    sessions: int
    #: Datagrams that are no sample.
    garbage: int
    #: From one end's loop to the other's.
    latency_ms: Spread
    #: From when to when no sample came, each longer than 0.2 s, in seconds of the session.
    pauses_s: list[tuple[float, float]]
    #: How late the sender's cycles of 1 ms began.
    lateness_us: Punctuality
    #: Cycles of the sender that were left out.
    slips: int
    #: At the sender.
    port: PortReport


class NeedReport(Report, frozen=True, kw_only=True):
    """What a direction needs when every stream is at its cap."""

    payload: int
    headers: int
    #: For RTCP, feedback and supervision.
    reserve: int
    #: What is left.
    spare: int


class LineReport(Report, frozen=True, kw_only=True):
    """One line of that arithmetic."""

    what: str
    #: The stream it is for; empty if it is for none.
    stream: str
    bps: int


class DirectionReport(Report, frozen=True, kw_only=True):
    """One direction of the link, of all lives of its two gateways."""

    #: The rate of whole frames.
    capacity_bps: int
    #: What is left for everything below haptics.
    below_haptics_bps: int
    #: The need at the caps.
    needed_at_caps_bps: NeedReport
    #: How that comes about, line by line.
    arithmetic: list[LineReport]
    #: Frames sent.
    frames: int
    #: What slots without a sample gave to the levels below haptics, on average.
    freed_bps: int
    frames_lost: int
    #: Frames that were received and dropped, by reason.
    frames_dropped: dict[str, int]
    #: Octets of all frames sent, by what they carried.
    octets: dict[str, int]
    #: Their shares, which add up to 100.
    octets_percent: dict[str, float]
    #: The queue of each level at the sender.
    queue: dict[str, QueueFigures]
    #: Packets by the form of their header, and octets of headers, by flow.
    headers: dict[str, dict[str, int]]
    #: Packets that the sender did not take, by reason.
    refused: dict[str, int]
    #: Packets that were delivered, by flow.
    packets: dict[str, int]
    #: Packets that the receiver dropped, by reason.
    packets_dropped: dict[str, int]
    #: How late slots began.
    lateness_us: Punctuality
    #: From a slot's deadline until its frame had been sent.
    sent_after_us: Punctuality
    #: Slots that were left out.
    slips: int


class RadioReport(Report, frozen=True, kw_only=True):
    """What the radio path did to the frames that this end sent."""

    #: The delay of the newest frame.
    delay_ns: int
    #: The shortest delay.
    delay_min_ns: int
    #: The longest delay.
    delay_max_ns: int
    frames_sent: int
    #: Frames that the path lost.
    frames_lost: int
    #: Frames in which it flipped bits.
    frames_hit: int
    bits_flipped: int
    #: Frames that have not arrived yet.
    frames_under_way: int
    #: For how long the pass gave no signal.
    no_signal_ns: int | None = None
    #: The radio profile.
    profile: str | None = None
    #: `uplink` or `downlink`.
    direction: str | None = None
    #: For how long blackouts let nothing through.
    blackout_ns: int | None = None
    #: What the orbit predicts; of a profile with a pass.
    contact: ContactWindows | None = None


class PeerEventReport(Report, frozen=True, kw_only=True):
    """Something that happened on the path to the other end."""

    #: Since its gateway began.
    at_ns: int
    #: In words.
    what: str


class PeerReport(Report, frozen=True, kw_only=True):
    """The path to the other end, if it is on another machine; of the last life of the gateway.

    Every datagram received is counted once: as taken, of a handshake, or dropped.
    """

    #: Whether the datagrams were encrypted and authenticated.
    protected: bool
    #: The identity that the other end must prove; left out without protection.
    identity: str | None = None
    #: Where frames went last; null if the other end was never found.
    address: str | None
    #: Since when frames could be sent, without a pause; null: they could not.
    session_ns: int | None
    #: Handshakes with both ends proven.
    sessions: int
    #: Handshakes that came to nothing.
    failed_attempts: int
    address_changes: int
    #: Datagrams with frames that were sent.
    sent: int
    #: Frames that were not sent, because there was no session or no address.
    unsent: int
    #: Datagrams whose frame was taken.
    taken: int
    #: Datagrams of handshakes that were heeded.
    handshake_datagrams: int
    #: Dropped datagrams, by reason.
    dropped: dict[str, int]
    #: The newest 50 events.
    events: list[PeerEventReport]


class GatewayReport(Report, frozen=True, kw_only=True):
    """What only this end of the link knows, of the last life of its gateway."""

    supervision: SupervisionFigures | None = None
    radio: RadioReport | None = None
    #: Datagrams from addresses that have no business there, by port.
    strangers: dict[str, int]
    #: Datagrams that the network did not take.
    unsent: int
    #: The path to the other end; left out if both ends ran on this machine.
    peer: PeerReport | None = None
    #: The clock of the other end; left out if both ends ran on this machine.
    clock: ClockFigures | None = None
    #: The radio on the way in; only where `--trainer` put both directions at this end.
    radio_back: RadioReport | None = None


class SkewReport(Report, frozen=True, kw_only=True):
    """How much later the first of two senses came than the second."""

    p50: float
    p95: float
    p99: float
    #: The one farthest from zero.
    max: float
    count: int


class Terms(Report, frozen=True, kw_only=True):
    """What a latency is made of; the means of its terms, which add up."""

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
    """By how much the force of an event comes before its picture, term by term."""

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

    #: What carries it.
    stream: str
    #: Contacts that were perceived.
    perceived: int
    #: Contacts that were not.
    missed: int
    #: From the contact to its perception.
    latency_ms: Ranks
    #: The same by the stamps that travelled with the stream.
    stamped_latency_ms: Ranks
    #: The captured instant by the stamps, less the contact's.
    stamp_error_ms: Ranks
    #: Number of the clearest perceptions, by which the stamps are judged.
    judged: int
    #: Their median error; null without any.
    judged_error_ms: float | None
    #: Where that median lies with 95 % confidence.
    confident_ms: tuple[float, float] | None
    #: Where it may lie.
    allowed_error_ms: tuple[float, float]
    #: Whether the stamps agree with the content; null if there is too little to say.
    agrees: bool | None
    #: Lights, clicks or steps that were found, those of no contact included.
    found: int


class ContentSkew(Report, frozen=True, kw_only=True):
    """How much later the first of two senses perceived a contact than the second."""

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
    """Contacts with the task board, joined with what was seen, heard and felt of them."""

    #: Contacts with a target.
    events: int
    touches_beside_targets: int
    #: Contacts that followed another one at once.
    bounces: int
    #: `light`, `click` and `force`; null for a sense that contacts do not reach.
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
    """One process, over all its lives."""

    cpu_s: float
    #: How often it was started again.
    restarts: int
    #: The last fault of an input's source.
    source_fault: str | None = None
    #: `fifo` with real-time priority, `other` without the permission for it.
    scheduler: str | None = None
    #: The camera that the selector has selected.
    selected: str | None = None
    #: Interarrival jitter (RFC 3550, 6.4.1).
    jitter_ns: int | None = None
    #: How long the playout holds sound back at present.
    playout_delay_ns: int | None = None
    #: Why it ended last, if it was not told to.
    last_error: str | None = None
    #: Since when an input has given nothing, if it is too long.
    silent_s: float | None = None
    #: Its counters.
    counts: dict[str, int] | None = None


class Warning(Report, frozen=True, kw_only=True):
    """Something that made the session worse than it has to be."""

    #: Which kind: see `pipelines.report.warnings`.
    what: str
    #: The process or stream.
    where: str
    #: What was measured, in words.
    measured: str
    #: What mends it.
    mend: str


class CostsReport(Report, frozen=True, kw_only=True):
    """The time of each coding step on virtual time."""

    capture_ms: float
    encode_ms: float
    decode_ms: float
    voice_encode_ms: float
    voice_decode_ms: float


class ReplayedStream(Report, frozen=True, kw_only=True):
    """The pictures of a replayed stream, held against those of the recording.

    A live replay has the first of them only.
    """

    #: Access units in the recording, as they were sent.
    units_recorded: int
    #: Of these, arrived whole; 0 if they were coded anew.
    units_received: int | None = None
    #: Of these, arrived whole in the recorded session; left out if that is not known.
    recorded_received: int | None = None
    #: Arrived alike, octet by octet, in both.
    same_received: int | None = None
    #: Decoded pictures that equal what was sent.
    pictures_same: int | None = None
    #: PSNR of the luma of all decoded pictures against what was sent, at most 99; with losses.
    psnr_db_mean: float | None = None
    #: The twentieth that is worst begins here.
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
    #: Haptic samples that were not sent, because a newer one belonged to the same cycle; of a
    #: simulation only.
    samples_superseded: int | None = None
    #: By channel: messages that the recording lacks.
    missing: dict[str, int]


class SimulationReport(Report, frozen=True, kw_only=True):
    """The inputs of this simulation."""

    seed: int
    #: The radio profile.
    radio: str
    #: Whether it had media streams.
    media: bool
    costs: CostsReport


class RecordedChannel(Report, frozen=True, kw_only=True):
    """One channel of a recording, in messages."""

    #: In the file.
    kept: int
    #: Gone before they were read.
    missed: int
    #: Dropped because the disk was too slow or full.
    dropped: int


class RecorderReport(Report, frozen=True, kw_only=True):
    """What was recorded of the session; of a recorder that was killed, until its last report."""

    #: The newest file; null if nothing was being recorded at the end.
    file: str | None
    #: Files begun.
    parts: int
    #: Octets written.
    octets: int
    #: How often a file could not be opened or written.
    disk_faults: int
    #: Key pictures that came too late: a black one is in their place.
    late_keys: int
    #: Why nothing could be written at the end; null if all was well.
    fault: str | None
    #: By name.
    channels: dict[str, RecordedChannel]


class ArmEventReport(Report, frozen=True, kw_only=True):
    """Something that happened to the robot's haptic port."""

    #: Since the session began.
    at_s: float
    #: In words.
    what: str


class ArmReport(Report, frozen=True, kw_only=True):
    """Who drives the robot, where a partner may, too (docs/rtc.md)."""

    #: `iss` or `partner`; null: nobody.
    owner: str | None
    #: Who was to drive.
    wanted: str
    #: Whether the owner has yet to release the dead-man button.
    waiting: bool
    #: How often the port changed hands, the start included.
    turns: int
    #: Datagrams that came while their sender did not drive, by sender.
    refused: dict[str, int]
    #: The newest 200 events.
    events: list[ArmEventReport]


class SecondArmReport(Report, frozen=True, kw_only=True):
    """The arm that only a partner drives (docs/rtc.md)."""

    #: Samples sent to the partner.
    sent: int
    #: Samples of the partner that were the newest.
    received: int
    #: Gaps in their numbers.
    lost: int
    #: Datagrams that are neither sample nor greeting.
    garbage: int
    #: Samples of another session.
    strays: int
    #: Sessions begun.
    sessions: int
    #: Energy that went into the port at the arm, and that came out there.
    energy_in_uj: int
    energy_out_uj: int


class ExerciseReport(Report, frozen=True, kw_only=True):
    """Something that a trainer did."""

    #: Since the session began.
    at_s: float
    #: In words.
    what: str


class RtcStreamReport(Report, frozen=True, kw_only=True):
    """One stream of the leg to a partner, in RTP packets."""

    packets: int
    #: Of the payload, over the whole session.
    mean_bps: int
    #: By the reports of who received them.
    lost: int
    #: Asked for again by NACK.
    asked: int
    #: Sent again.
    repeated: int
    #: PLI and FIR.
    keys_asked: int


class RtcShownReport(Report, frozen=True, kw_only=True):
    """What was shown or heard of a partner."""

    #: Pictures, or blocks of 20 ms of voice.
    displayed: int
    #: How long a picture was shown that a loss has damaged.
    damaged_ms: float
    #: From capture to display, above the least delay of the network in the last 30 s: nobody knows
    #: the partner's clock.
    latency_ms: Spread


class RtcReport(Report, frozen=True, kw_only=True):
    """The leg to a partner across the Internet."""

    #: Connections that stood.
    connections: int
    ice_restarts: int
    #: How the addresses of the newest one were found, ours and theirs: host, srflx, prflx or relay.
    route: str | None
    #: Of the newest answer to a report.
    round_trip_ms: float | None
    #: Of the picture that was coded for the partner, in the end.
    rate_bps: int
    #: How often it was lowered because the partner could take no more.
    rate_lowered: int
    #: Requests and packets that were none of a partner.
    garbage: int
    refused: int
    #: Haptic samples: `taken` from the partner, `given` to it, or `left_out` for a slow network.
    samples: dict[str, int]
    #: `rtc_video`, `rtc_speech` and the downlink's to the partner; `rtc_camera`, `rtc_voice` of it.
    streams: dict[str, RtcStreamReport]
    #: `rtc_camera` and `rtc_voice`.
    shown: dict[str, RtcShownReport]


class TaskStepReport(Report, frozen=True, kw_only=True):
    """A step of Fig. 14 of the paper."""

    #: Since the session began.
    at_s: float
    #: In words.
    step: str


class TaskRunReport(Report, frozen=True, kw_only=True):
    """One run of a task."""

    name: str
    #: Its number in the session.
    run: int
    #: `finished`, `aborted`, `timed_out`, `lost_signal`; `open` if the session ended during it.
    result: str
    #: Why it did not finish; empty if it did.
    reason: str
    #: When it was selected, since the session began.
    selected_s: float
    #: From the cosmonaut's start to its end; null if it was never started.
    seconds: float | None
    #: The tip's way while the cosmonaut drove.
    path_m: float
    #: The board's force on the tip.
    force_max_n: float
    force_mean_n: float
    #: Distance from what was to be reached or followed (m), or from the force to be held (N); null
    #: where there was none.
    error_mean: float | None
    error_max: float | None
    #: Of the link meanwhile, both ways.
    frames: int
    frames_lost: int
    #: The longer delay of both directions at its end.
    delay_ms: float
    #: Each is logged once.
    steps: list[TaskStepReport]


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
    #: The stream that they are about; empty if the process alone says that.
    stream: str
    blocks: list[TraceBlock]


class EndTrace(Report, frozen=True, kw_only=True):
    """What `report join` needs of an end."""

    #: The setup, as TOML.
    setup: str
    #: Unix time minus the clock of all instants here.
    wall_offset_ns: int
    #: From when to when the end ran.
    began_ns: int
    ended_ns: int
    #: The numbers of the lives of this end's gateway, and of those that it met of the other's.
    lives: list[int]
    peers: list[int]
    series: list[TraceSeries]


class SessionReport(Report, frozen=True, kw_only=True):
    """The report of `stream`, `replay` and `simulate`."""

    #: The setup's name.
    setup: str
    #: The only end that ran here, `ground` or `space`; what the other knows is 0, empty or null.
    end: str | None = None
    #: How long the session ran. Mean rates are over the time outside of `stopped_s`.
    seconds: float
    #: From when to when ground control had stopped it; left out if never.
    stopped_s: list[tuple[float, float]] | None = None
    streams: dict[str, StreamReport]
    #: `up` and `down`.
    haptic: dict[str, HapticReport]
    #: A real joystick; null with the simulated one.
    joystick: JoystickFigures | None
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
    #: For how much of the time sound and picture were together; null without both.
    lip_sync: LipSyncReport | None
    cpu: CpuReport
    processes: dict[str, ProcessReport]
    #: What broke a promise of the project; with any, the exit code is 1. A cap was exceeded, or a
    #: stream or the haptic samples stopped although there was a signal. Or a stamp was wrong,
    #: energy was made, a joystick failed, or values of this report were lost.
    failures: list[str]
    #: What made the session worse than it has to be, with what mends it.
    warnings: list[Warning]
    #: Who drove the robot; only where a partner may, too.
    arm: ArmReport | None = None
    #: The arm that only a partner drives; left out without one.
    second_arm: SecondArmReport | None = None
    #: What the trainer did, oldest first; left out if nothing.
    exercises: list[ExerciseReport] | None = None
    #: The recording; left out without one.
    recorder: RecorderReport | None = None
    #: The leg to a partner; left out without one.
    rtc: RtcReport | None = None
    #: The runs of tasks, oldest first; left out of a session without a plan.
    tasks: list[TaskRunReport] | None = None
    #: What a join with the other end's report needs; of one end alone.
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

    #: The setup's name.
    setup: str
    #: How long the link ran.
    seconds: float
    #: The ends that ran here.
    ends: list[str]
    radio: LinkRadio
    #: `uplink` and `downlink`.
    link: dict[str, DirectionReport]
    #: By end.
    gateways: dict[str, GatewayReport]
    cpu: CpuReport
    processes: dict[str, ProcessReport]
    #: What broke a promise of the project; with any, the exit code is 1.
    failures: list[str]
    #: What made the link worse than it has to be, with what mends it.
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
    figures: list[FigureReport]


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
    joystick: OperationFigures
    transitions: list[TransitionReport]


AnyReport = TypeVar("AnyReport", bound=Report)


def to_builtins(report: object) -> Any:
    """A report, or what holds some, as tables, lists, strings and numbers."""
    return msgspec.to_builtins(report)


def to_json(report: object) -> str:
    """A report, or what holds some, as text indented by two, with a newline at its end."""
    return json.dumps(to_builtins(report), indent=2) + "\n"


def from_json(text: str | bytes, kind: type[AnyReport]) -> AnyReport:
    """The report in `text`; msgspec.ValidationError if it is none of this `kind`."""
    return msgspec.json.decode(text, type=kind)
