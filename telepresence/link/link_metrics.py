"""What the link counts: one typed record for each of its parts. A core.

The instants of `SupervisionMetrics` are counted from its `begun_ns`. The word before the unit in a
name says whether it is an instant or a duration; `_ns` alone does not.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypedDict

from kontur_av.metrics import Flat, Least, Most, Newest


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueMetrics:
    """The queue of one level."""

    #: When it is full: `reject_newest` or `drop_oldest`.
    policy: str
    #: Octets that may wait.
    depth_octets: Newest[int]
    #: Packets that may wait.
    depth_packets: Newest[int]
    #: Packets waiting, without one partly sent.
    packets: Newest[int]
    #: Sum of their lengths; each counts as 8 octets at least.
    octets: Newest[int]
    #: The oldest packet's age, also of one partly sent.
    oldest_age_ns: Newest[int]
    #: The most that ever waited.
    max_packets: Most[int]
    #: The most that ever waited.
    max_octets: Most[int]
    #: The longest from arrival until the last octet was sent, or the drop.
    max_age_ns: Most[int]
    #: Packets put into the queue.
    accepted: int
    #: Packets delayed by their level's rate limit.
    delayed: int
    #: Packets dropped, by reason.
    drops: Mapping[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairSentMetrics:
    """What a sender does so that the other end can restore lost frames."""

    #: `off`, `idle`: in idle slots, `reserve`: also in slots that are kept for it, or `waiting`: in
    #: neither until losses are reported, because the path leaves out what is idle.
    mode: str
    #: The reason for it.
    why: str
    #: Repair zones kept behind each voice packet.
    after_voice: Newest[int]
    #: Repair zones kept behind each picture.
    after_picture: Newest[int]
    #: One picture of so many is left out; 0: none.
    leave_out: Newest[int]
    #: The share of frames that the other end lost in the last two seconds.
    lost: float
    #: The packets that this cost there, as a share of the frames.
    torn: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SenderMetrics:
    """One direction at its sender (`LinkSender`)."""

    #: The rate of whole frames.
    capacity_bps: Newest[int] = 0
    #: Frames sent.
    frames: int = 0
    #: Octets of all frames sent, by what they carried.
    octets: Mapping[str, int] = field(default_factory=dict)
    #: The queue of each level.
    queue: Mapping[str, QueueMetrics] = field(default_factory=dict)
    haptic_sent: int = 0
    #: Samples replaced by a newer one before their slot.
    haptic_superseded: int = 0
    #: By flow: packets by form of header, and octets of headers.
    headers: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    #: Packets not taken, by reason.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Null where the setup repairs nothing.
    repair_sent: RepairSentMetrics | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairMetrics:
    """What repair zones restored of lost frames (`RepairedPackets`)."""

    #: Packet zones restored.
    zones: int = 0
    #: Lost zones that were not restored within the code's window.
    given_up: int = 0
    #: Repair zones that contradict what came: a wrong frame passed its FECF.
    contradictions: int = 0
    #: Packets that came out when a zone was restored.
    packets: int = 0
    #: Restored packets dropped: newer ones of their flow had come, or voice was too late.
    late: int = 0
    #: The longest wait for a zone that was restored.
    wait_max_ns: Most[int] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverMetrics:
    """One direction at its receiver (`LinkReceiver`)."""

    #: Good frames.
    frames_received: int = 0
    frames_lost: int = 0
    #: Received frames dropped, by reason.
    frames_dropped: Mapping[str, int] = field(default_factory=dict)
    #: How often the peer's frame count began anew.
    restarts: int = 0
    haptic_received: int = 0
    #: Samples before the connection was approved.
    haptic_unapproved: int = 0
    supervision_received: int = 0
    #: Packets delivered, by flow.
    packets: Mapping[str, int] = field(default_factory=dict)
    #: Packets dropped, by reason.
    packets_dropped: Mapping[str, int] = field(default_factory=dict)
    #: Null where the setup repairs nothing.
    repaired: RepairMetrics | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactWindows:
    """What the orbit predicts of a pass; `_s` counts from acquisition of signal."""

    #: Acquisition of signal, UTC (ISO 8601).
    acquisition: str
    #: Always 0.
    acquisition_s: float = 0.0
    #: From then on fades seldom end the lock; null if they always do.
    usable_from_s: float | None
    #: Until then.
    usable_to_s: float | None
    #: Loss of signal.
    loss_s: float
    #: Culmination.
    peak_s: float
    #: Elevation at culmination, in degrees.
    peak_deg: float
    #: Least range.
    nearest_km: float
    #: Largest range.
    farthest_km: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelMetrics:
    """What the radio profile did to one direction."""

    #: The radio profile.
    profile: str
    #: `uplink` or `downlink`.
    direction: str
    #: Time in blackouts.
    blackout_ns: int
    #: What the orbit predicts; of a profile with a pass.
    contact: ContactWindows | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PathMetrics:
    """The radio path from this end (`RadioPath`)."""

    #: The delay of the newest frame.
    delay_ns: Newest[int]
    #: The shortest delay.
    delay_min_ns: Least[int]
    #: The longest delay.
    delay_max_ns: Most[int]
    #: Frames put into the path.
    frames_sent: int
    #: Frames that the path lost.
    frames_lost: int
    #: Frames in which it flipped bits.
    frames_hit: int
    bits_flipped: int
    #: Frames that have not arrived yet.
    frames_under_way: Newest[int]
    #: Time in which the pass gave no signal.
    no_signal_ns: int | None = None
    channel: Flat[ChannelMetrics] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherEndMetrics:
    """What supervision knows of the other end."""

    #: Its present start; null before its first message.
    boot_id: Newest[int | None]
    #: Its state by its last message; null without signal.
    state: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactMetrics:
    """One contact: from acquisition to loss of signal, counted from `begun_ns`."""

    acquired_ns: int
    #: When the connection was approved, if it was.
    connected_ns: int | None
    #: When the last good frame came; null: it lasts.
    lost_ns: int | None


Transition = TypedDict("Transition", {"at_ns": int, "from": str, "to": str, "why": str})


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisionMetrics:
    """Negotiation and supervision of the link at this end (`Supervisor`)."""

    #: `master` or `slave`.
    role: str
    #: The number of this end's present start.
    boot_id: Newest[int]
    #: The state of the link (docs/wire-formats.md).
    state: str
    #: The reason for it.
    why: str
    #: Whether good frames arrive.
    signal: bool
    #: Whether the peer says that it receives.
    peer_hears: bool
    #: Whether it delivers what it receives.
    delivering: bool
    peer: OtherEndMetrics
    #: When this end began, on the session's clock.
    begun_ns: Newest[int]
    #: When the present state began, counted from `begun_ns`.
    since_ns: Newest[int]
    #: Time in each state.
    in_state_ns: dict[str, int]
    #: Messages, signals, restarts, resets and time-outs.
    counts: dict[str, int]
    #: Time with signal.
    contact_ns: int
    #: The longest time without signal between two contacts.
    longest_gap_ns: Most[int]
    #: The newest 64 contacts.
    contacts: list[ContactMetrics]
    #: The newest 64 transitions: instant since `begun_ns`, states and reason.
    history: list[Transition]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockMetrics:
    """What this end knows of the peer's clock (`ClockExchange`)."""

    #: When the estimate holds, on this end's clock.
    at_ns: Newest[int]
    #: The peer's clock minus this end's, as wall time at their start; null if unknown.
    offset_ns: Newest[int | None]
    #: The true offset is at most this far away.
    error_ns: Newest[int | None]
    #: How much faster the peer's clock is, in 10⁻⁹.
    drift_ppb: Newest[int | None]
    drift_error_ppb: Newest[int | None]
    messages_sent: int
    messages_received: int
    #: Restarts of the estimate, after a clock was stepped.
    restarts: int


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayMetrics:
    """All that one end of the link counts (`Gateway`)."""

    transmit: SenderMetrics
    receive: ReceiverMetrics
    radio: Newest[PathMetrics]
    supervision: Newest[SupervisionMetrics]
    #: Of a gateway that compares its clock with the peer's.
    clock: Newest[ClockMetrics] | None = None


#: Host and UDP port.
Address = tuple[str, int]

#: How many events are kept.
_DEPTH = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerEvent:
    """What happened on the path; `at_ns` counts from `PeerMetrics.begun_ns`."""

    at_ns: int
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerMetrics:
    """The path to the other end.

    Every datagram received is counted once: in `taken`, in `handshake_datagrams`, or by the reason
    for which it was dropped.
    """

    #: When the gateway began, on its own clock.
    begun_ns: Newest[int]
    #: Whether datagrams are encrypted and authenticated.
    protected: bool
    #: The identity that the other end must prove.
    identity: str | None = None
    #: Where frames go; null while unknown.
    address: str | None
    #: Since when, after `begun_ns`, frames can be sent; null: they cannot.
    session_ns: Newest[int] | None
    #: Handshakes done.
    sessions: int = 0
    #: Handshakes given up.
    failed_attempts: int = 0
    #: Changes of the other end's address.
    address_changes: int
    #: Records sent: with frames, with reports, and signs of life.
    sent: int
    #: Frames not sent for want of session or address.
    unsent: int
    #: Records taken.
    taken: int
    #: Datagrams of handshakes that were heeded.
    handshake_datagrams: int = 0
    #: Dropped datagrams by reason: `unknown`, or those of docs/security.md.
    dropped: Mapping[str, int]
    #: Octets of the datagrams sent that have frames, with UDP and IP.
    octets_sent: int = 0
    #: Whether a datagram may have several frames on the way out.
    bundled: Newest[bool] = False
    #: Whether idle octets are left out on the way out.
    compact: Newest[bool] = False
    #: How long frames wait now for one before them that is missing; 0 where none overtake.
    order_budget_ns: Newest[int] = 0
    #: Frames that others had overtaken, and that were put back in order.
    frames_put_back: int = 0
    #: Frames that came too late for that.
    frames_too_late: int = 0
    #: What goes over the path now: `all`, `no idle`, `lower caps`, `fewer pictures` or `no video`;
    #: `too slow` where nothing less would help.
    path_state: Newest[str] = "all"
    #: Why not all.
    path_why: Newest[str] = ""
    #: Of what is sent, the rate that arrives at the other end, with UDP and IP.
    path_bps: Newest[int] = 0
    #: How long it waits on the path.
    path_queue_ns: Newest[int] = 0
    #: The share of its records that was lost in the last half second.
    path_loss: Newest[float] = 0.0
    #: What the videos of the way out may take together now, in RTP payload.
    video_cap_bps: Newest[int] = 0
    #: The newest 50.
    events: tuple[PeerEvent, ...]


def address_text(address: Address) -> str:
    """HOST:PORT, or [IPv6]:PORT."""
    host, port = address
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


@dataclass(slots=True)
class PeerHistory:
    """The newest events of a path that began at `begun_ns`."""

    begun_ns: int
    _events: deque[PeerEvent] = field(default_factory=lambda: deque(maxlen=_DEPTH))

    def add(self, what: str, now_ns: int) -> None:
        """Something happened. What has just been told is not told again."""
        if not self._events or self._events[-1].what != what:
            self._events.append(PeerEvent(at_ns=now_ns - self.begun_ns, what=what))

    def events(self) -> tuple[PeerEvent, ...]:
        return tuple(self._events)
