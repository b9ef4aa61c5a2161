"""The check of one end by itself, before a contact and during it. A core.

"First it is necessary to verify the correct local interaction between Main- and Com-CPU on both
sides independently" (Stelzer et al., 2017, section 6). The Main-CPU is here the side of the
applications: their packets and queues. The Com-CPU is the side of the clocked frames.
"""

from collections.abc import Sequence
from itertools import islice

from kontur_av.clock import NS_PER_MS
from telepresence.link.flows import Flow, FlowKind, HapticReceived, PacketReceived
from telepresence.link.profile import LinkProfile
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

#: Frames that the system refuses for this long are a fault of this end.
REFUSED_NS = 200 * NS_PER_MS
#: Long enough to be divided among frames, and plausible for each kind of flow.
_OCTETS = 96
_HEADS = {
    FlowKind.RTP: bytes([0x80, 96]),
    FlowKind.RTCP: bytes([0x80, 200]),
    FlowKind.TMTC: bytes([0x18, 1, 0xC0, 0, 0, _OCTETS - 7]),
    FlowKind.RAW: b"",
}
#: A packet that has not come through in this many slots does not come.
_SLOTS = 20 * _OCTETS


def self_test(profile: LinkProfile, flows: Sequence[Flow]) -> str | None:
    """Send a packet of each flow, and samples, through a sender and a receiver of this end.

    Returns what did not come out as it went in; None if all did.
    """
    sender, receiver = LinkSender(profile, flows), LinkReceiver(profile, flows)
    receiver.deliver = True
    body = bytes(range(_OCTETS))
    sample = body[: profile.insert_octets]
    slots = iter(range(_SLOTS * len(flows)))
    for flow in flows:
        head = _HEADS[flow.kind]
        packet = head + body[len(head) :]
        if not sender.handle_packet(flow.name, packet, 0):
            return f"self-test: this end's queue refuses a packet of {flow.name}"
        out: set[bytes] = set()
        for slot in islice(slots, _SLOTS):
            now_ns = slot * profile.slot_ns
            sender.handle_haptic(sample, now_ns)
            if not receiver.handle_frame(sender.poll_transmit(now_ns), now_ns):
                return "self-test: this end does not read its own frames"
            while receiver.events:
                event = receiver.events.popleft()
                if isinstance(event, HapticReceived):
                    out.add(event.sample)
                elif isinstance(event, PacketReceived) and event.flow is flow:
                    out.add(event.data)
            if packet in out:
                break
        if out != {packet, sample}:
            return f"self-test: {flow.name} or a sample does not come through this end's own frames"
    return None


class LocalCheck:
    """Judges whether the frames of this end leave it.

    Call `handle_frames` regularly, with counts since the start. Before the next frame reaches the
    system, `fault` stays.

    fault: what does not work; None if nothing is known to fail.
    """

    def __init__(self, fault: str | None, now_ns: int) -> None:
        self.fault = self._of_test = fault
        self._refused, self._left = 0, 0
        #: Since when every frame has been refused.
        self._since_ns = now_ns

    def handle_frames(self, made: int, refused: int, reason: str, now_ns: int) -> None:
        """`made` frames were made so far, of which the system refused `refused` for `reason`."""
        left = made - refused
        if left > self._left or refused == self._refused:
            self._since_ns = now_ns
        if left > self._left:
            self.fault = self._of_test
        elif refused > self._refused and now_ns - self._since_ns >= REFUSED_NS:
            self.fault = self._of_test or f"this machine does not send the frames: {reason}"
        self._left, self._refused = left, refused
