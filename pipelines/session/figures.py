"""What each kind of process counts and measures, declared once.

Counters count since the process began, and add up over its lives. Gauges have newest values, which
replace those before. A process tells several records, such as `LoopCounters` and `GatewayCounters`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Self

from kontur_av.streams.staleness import State
from pipelines.session.task_journal import TaskRow
from telepresence.haptics.figures import JoystickFigures
from telepresence.haptics.ownership import OwnershipFigures
from telepresence.link.figures import GatewayFigures, PathFigures
from telepresence.link.peer.figures import PeerFigures

#: Name of the figure that tells ground control which page holds the handle.
HOLDER = "hand.holder"


@dataclass(frozen=True, slots=True, kw_only=True)
class Counters:
    """Counters of one life of a process; None: this process has no such counter."""

    def plus(self, later: Self) -> Self:
        """Return the counters of both lives together."""
        names = [one.name for one in fields(self)]
        return replace(
            self, **{name: _sum(getattr(self, name), getattr(later, name)) for name in names}
        )

    def by_name(self) -> dict[str, int]:
        """Return the counters by their names in the report; of a table those that are not 0."""
        found: dict[str, int] = {}
        for one in fields(self):
            value: int | Mapping[str, int] | None = getattr(self, one.name)
            if isinstance(value, Mapping):
                found |= {f"{one.name}_{key}": count for key, count in value.items() if count}
            elif value is not None:
                found[one.name] = value
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Gauges:
    """Newest values of a process; None: not known yet."""

    def over(self, earlier: Self) -> Self:
        """Return these values, and the earlier ones where these are not known."""
        names = [one.name for one in fields(self) if getattr(self, one.name) is None]
        return replace(self, **{name: getattr(earlier, name) for name in names})


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeCounters(Counters):
    """The way of the figures themselves."""

    #: Values of rows that were dropped because the launcher did not keep up.
    probe_values_dropped: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopCounters(Counters):
    """A periodic loop."""

    #: Cycles that were left out.
    slips: int = 0
    #: Cycles that were done.
    cycles: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayCounters(Counters):
    """The sockets of a gateway."""

    #: Frames that the network did not take.
    unsent: int = 0
    #: Datagrams from addresses that have no business there, by port.
    strangers: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayGauges(Gauges):
    """A gateway: its end of the link, of this life."""

    link: GatewayFigures


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerGauges(Gauges):
    """A gateway whose other end is on another machine: its path, of this life.

    back: the radio on the way in, if it is simulated here, too.
    """

    peer: PeerFigures
    back: PathFigures | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HapticCounters(Counters):
    """An end of haptics."""

    #: Samples sent.
    sent: int = 0
    #: Samples whose number says that they were the newest.
    received: int = 0
    #: Gaps in the sequence numbers.
    lost: int = 0
    #: Samples that came after a newer one.
    late: int = 0
    #: Samples that came twice.
    repeated: int = 0
    #: Samples of another session: of an earlier life of an end, or replayed.
    strays: int = 0
    #: Greetings received, with which sessions begin.
    greetings: int = 0
    #: Datagrams that are neither sample nor greeting.
    garbage: int = 0
    #: Sessions begun; there is a new one every 30 s.
    sessions: int = 0
    #: How often a session began with a new life of the peer.
    restarts: int = 0
    #: Samples that the deadband left out; only with a deadband.
    left_out: int | None = None
    #: Energy that went from this end into the port.
    energy_in_uj: int = 0
    #: Energy that came out of the port at this end.
    energy_out_uj: int = 0
    #: Cycles in which the passivity controller acted.
    passivity_acted: int = 0
    #: Totals of the peer's energy that could not be right.
    totals_refused: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnerGauges(Gauges):
    """A robot that a partner may drive, too: who does."""

    arm: OwnershipFigures


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskCounters(Counters):
    """The process of tasks."""

    #: Runs that should have had a file of their own, and have none.
    unrecorded: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskGauges(Gauges):
    """The newest runs of tasks. Those before are kept by who is told.

    unrecorded_why: why the newest run without a file of its own has none.
    """

    rows: tuple[TaskRow, ...]
    unrecorded_why: str = ""

    def over(self, earlier: Self) -> Self:
        """Return all runs, oldest first, in their newest state.

        The row of a run whose process was killed has the steps that were told before.
        """
        runs = {row.run: row for row in earlier.rows}
        for row in self.rows:
            known = runs.get(row.run)
            runs[row.run] = row if known is None else row.with_steps_of(known)
        return replace(self, rows=tuple(runs[number] for number in sorted(runs)))


@dataclass(frozen=True, slots=True, kw_only=True)
class WallCounters(Counters):
    """A joystick that renders the wall of the robot's side (`--hand mediated`)."""

    #: Messages with a wall, or with none, that were taken.
    walls: int = 0
    #: Messages that were not newer than one before.
    walls_stale: int = 0
    #: Datagrams that are no such message.
    walls_garbage: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PortGauges(Gauges):
    """The haptic port of an end: energy that it may still give out, and the least ever seen."""

    credit_uj: int
    least_uj: int


@dataclass(frozen=True, slots=True, kw_only=True)
class JoystickGauges(Gauges):
    """A real joystick."""

    joystick: JoystickFigures


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureCounters(Counters):
    """A camera or a microphone."""

    #: Pictures or blocks of sound captured.
    captured: int = 0
    #: Faults that the source has survived.
    source_faults: int = 0
    #: Of the captured ones, those of a browser page; only in a session with pages.
    from_page: int | None = None
    #: What pages gave in vain: too old, of another size, or before what was captured last.
    page_refused: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureGauges(Gauges):
    """A camera or a microphone.

    captured_ns: when it captured last. source_fault: the last fault of its own source.
    live_source: "page" while a browser page has the input, else "own".
    """

    captured_ns: int | None = None
    source_fault: str | None = None
    live_source: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoCounters(Counters):
    """The merge of two cameras."""

    #: Pictures merged of two.
    paired: int = 0
    #: Pictures with one camera only.
    single: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SendingCounters(Counters):
    """The sender of a stream."""

    #: Pictures or blocks of sound that came to the sender.
    frames_captured: int = 0
    frames_encoded: int = 0
    frames_sent: int = 0
    #: Pictures or blocks that the encoder's budget had no room for.
    frames_refused: int = 0
    rtp_packets_sent: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSendingCounters(Counters):
    """The sender of a picture."""

    #: Messages of losses and requests for key pictures.
    feedback_received: int = 0
    #: Datagrams that are no feedback.
    feedback_garbage: int = 0
    #: What the cap gained from samples that were left out; only where it follows them.
    gained_bits: int | None = None
    #: How often that gain changed.
    gain_changes: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceptionCounters(Counters):
    """The receiver of a stream."""

    rtp_packets: int = 0
    #: Gaps in the sequence numbers.
    rtp_lost: int = 0
    rtp_reordered: int = 0
    rtp_duplicates: int = 0
    #: Packets that came after their turn.
    rtp_late: int = 0
    #: Datagrams that are no RTP of this stream.
    garbage: int = 0
    #: Senders heard, by their SSRC.
    sources: int = 0
    #: Units that came before a sender report gave their capture time.
    frames_undated: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoReceptionCounters(Counters):
    """The receiver of a picture."""

    #: Access units received.
    frames_received: int = 0
    #: Access units with gaps.
    frames_damaged: int = 0
    frames_decoded: int = 0
    #: Access units that the decoder could not decode.
    frames_corrupt: int = 0
    decoder_restarts: int = 0
    #: Pictures of another size than the stream's.
    frames_oversized: int = 0
    #: Key pictures asked for.
    pictures_asked_for: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class VoiceReceptionCounters(Counters):
    """The receiver of a voice, in blocks of sound."""

    frames_decoded: int = 0
    #: Blocks that the decoder had to make up.
    frames_concealed: int = 0
    #: Blocks that were restored from forward error correction.
    frames_recovered: int = 0
    #: Blocks that came too late to be played.
    frames_late: int = 0
    #: Blocks that were dropped to play sooner.
    frames_left_out: int = 0
    #: Silence that was inserted to play later.
    inserted_ns: int = 0
    frames_stretched: int = 0
    frames_shortened: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceptionGauges(Gauges):
    """The receiver of a stream. playout_delay_ns: how long sound is held back; of voices only."""

    jitter_ns: int
    playout_delay_ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayCounters(Counters):
    """What a display shows or plays of one stream."""

    #: Pictures or blocks that were shown or played; concealed sound does not count.
    frames_displayed: int = 0
    stale_ns: int = 0
    stale_episodes: int = 0
    frozen_ns: int = 0
    frozen_episodes: int = 0
    damaged_ns: int = 0
    damaged_episodes: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayGauges(Gauges):
    """How old what a display shows of one stream is, and its state."""

    age_ns: int
    state: State


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorCounters(Counters):
    """The selector of the camera."""

    #: Changes of the camera.
    switches: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorGauges(Gauges):
    """The selector: the selected camera."""

    selected: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TmtcCounters(Counters):
    """PUS and K2ACI at one end: the console's in space, the selector's on the ground."""

    #: Packets given to the radio.
    pus_sent: int = 0
    #: Their octets.
    pus_sent_octets: int = 0
    #: Packets that came by radio.
    pus_received: int = 0
    #: Packets and requests that could not be read.
    pus_garbage: int = 0
    #: Packets that waited for the token bucket.
    pus_delayed: int = 0
    #: Reports and news that were dropped because too many waited.
    pus_dropped: int = 0
    #: Telecommands sent, with their repetitions.
    pus_telecommands: int = 0
    #: Telecommands sent again.
    pus_telecommands_repeated: int = 0
    #: Telecommands carried out here.
    pus_executed: int = 0
    #: Telecommands that failed here.
    pus_failed: int = 0
    #: Telecommands that came again.
    pus_duplicates: int = 0
    #: Events reported.
    pus_events: int = 0
    #: Housekeeping reports sent.
    pus_housekeeping: int = 0
    #: Reports of applications that came in.
    pus_reports: int = 0
    #: Messages of K2ACI sent, with their repetitions.
    k2aci_sent: int = 0
    #: Messages of K2ACI sent again.
    k2aci_repeated: int = 0
    #: Messages of K2ACI that came in.
    k2aci_arrived: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainerEvent:
    """Something that a trainer did. at_ns: on the session's clock. what: in words."""

    at_ns: int
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainerGauges(Gauges):
    """The trainer: what it has done, oldest first; the newest 200."""

    events: tuple[TrainerEvent, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SnapshotCounters(Counters):
    """The snapshots of the displays."""

    #: Files written.
    snapshots: int = 0
    #: Files that could not be written.
    snapshots_failed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PageCounters(Counters):
    """The browser pages of a seat."""

    #: Web sockets opened.
    connections: int = 0
    #: Requests refused, by reason: `token`, `host` or `origin`.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Messages of pages that were no valid message; each closed its socket.
    garbage: int = 0
    #: Units of pictures and sound that a page was too slow for.
    units_left_out: int = 0
    #: Web sockets closed by the server: after garbage, or because a page stalled.
    sockets_closed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PageGauges(Gauges):
    """The browser pages of a seat.

    watching: how many are open. Without any, no figures are sent to it.
    holder: number of the page that holds the handle; 0: nobody does.
    """

    watching: int
    holder: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RtcCounters(Counters):
    """The leg to a partner across the Internet, by stream."""

    #: Connections of partners that stood.
    connections: int = 0
    #: Restarts of ICE.
    ice_restarts: int = 0
    #: Requests of HTTP refused, by reason: `token`, `strangers`, `offers` or `viewers`.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Offers that could not be used, and packets that were no RTP or RTCP.
    garbage: int = 0
    #: RTP packets sent or received.
    packets: Mapping[str, int] = field(default_factory=dict)
    #: Octets of their payload.
    octets: Mapping[str, int] = field(default_factory=dict)
    #: Packets lost, by the reports of who received them.
    packets_lost: Mapping[str, int] = field(default_factory=dict)
    #: Packets asked for again (NACK).
    packets_asked: Mapping[str, int] = field(default_factory=dict)
    #: Packets that were sent again.
    packets_repeated: Mapping[str, int] = field(default_factory=dict)
    #: Key pictures asked for (PLI, FIR).
    keys_asked: Mapping[str, int] = field(default_factory=dict)
    #: Haptic samples: `taken` from the partner, `given` to it, or `left_out` for a slow network.
    samples: Mapping[str, int] = field(default_factory=dict)
    #: How often the rate of the picture was lowered.
    rate_lowered: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RtcGauges(Gauges):
    """The leg to a partner. partners: connections that stand. rate_bps: of its picture.

    route: how the addresses of the newest connection were found (host, srflx, prflx, relay).
    round_trip_ns: of the newest answer to a report.
    """

    partners: int
    rate_bps: int
    route: str | None = None
    round_trip_ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderCounters(Counters):
    """The recorder, by channel."""

    #: Messages in the file.
    kept: Mapping[str, int] = field(default_factory=dict)
    #: Messages that were gone before they were read.
    missed: Mapping[str, int] = field(default_factory=dict)
    #: Messages dropped because the disk was too slow or full.
    dropped: Mapping[str, int] = field(default_factory=dict)
    #: Files begun.
    parts: int = 0
    #: Octets written.
    octets: int = 0
    #: How often a file could not be opened or written.
    disk_faults: int = 0
    #: Key pictures that came too late: a black one is in their place.
    late_keys: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderGauges(Gauges):
    """The recorder. file: the newest, "" while it does not record. fault: why it cannot write."""

    file: str
    fault: str
    waiting_octets: int


def _sum(
    one: int | Mapping[str, int] | None, other: int | Mapping[str, int] | None
) -> int | Mapping[str, int] | None:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return {key: one.get(key, 0) + other.get(key, 0) for key in {**one, **other}}
    if isinstance(one, int) and isinstance(other, int):
        return one + other
    return other if one is None else one
