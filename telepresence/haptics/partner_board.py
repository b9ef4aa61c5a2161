"""The joystick's port between our robot and a partner's: one of them at a time. A core.

Stelzer et al. 2017, section 7: in the partner institute's experiments the data goes directly
between space and its own task board. The first greeting for the other robot ends the present
ownership (`ownership.py`): our robot comes to rest before the partner's is reached, or vice versa.

A partner is a stranger. Only datagrams of a feedback's size and direction are passed on, at most
one a cycle; the joystick's link and its controller judge the rest.
"""

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from telepresence.haptics.ownership import HapticOwnership, Owner
from telepresence.haptics.sample import FLAG_FEEDBACK, SAMPLE_OCTETS, is_greeting, read_greeting

#: Without a sample for this long, the partner's robot is not there.
_SILENT_NS = 500 * NS_PER_MS


class PartnerBoard:
    """Call `handle_joystick` and `handle_partner` for each datagram, then the two `poll_`.

    ownership: of the joystick's port. `Owner.ISS`: it drives our robot; `Owner.PARTNER`: it drives
    the partner's. `RobotSide` says when our robot rests.
    """

    def __init__(self, ownership: HapticOwnership) -> None:
        self.ownership = ownership
        self._heard_ns: int | None = None
        self._to_partner: bytes | None = None
        self._to_joystick: bytes | None = None

    @property
    def left_out(self) -> bool:
        """Whether our robot must be off: it is not certain that the joystick asks for it."""
        return self.ownership.owner is not Owner.ISS

    def handle_joystick(self, data: bytes, now_ns: int) -> bool:
        """A datagram of the joystick in space came; return whether it is for our robot."""
        ownership = self.ownership
        if is_greeting(data):
            try:
                partner = read_greeting(data, feedback=False).partner
            except ProtocolError:
                # Our link counts it.
                return not self.left_out
            ownership.handle_order(Owner.PARTNER if partner else Owner.ISS, now_ns)
        if ownership.owner is Owner.PARTNER:
            self._to_partner = data
            return False
        return ownership.takes(Owner.ISS)

    def handle_partner(self, data: bytes, now_ns: int) -> None:
        """A datagram of the partner's robot came. Garbage is counted; this never raises."""
        if len(data) != SAMPLE_OCTETS or not data[2] & FLAG_FEEDBACK:
            self.ownership.garbage += 1
            return
        self._heard_ns = now_ns
        if self.ownership.owner is Owner.PARTNER:
            self._to_joystick = data

    def is_there(self, now_ns: int) -> bool:
        """Whether the partner's robot is heard."""
        return self._heard_ns is not None and now_ns - self._heard_ns <= _SILENT_NS

    def state(self, now_ns: int) -> str:
        """The partner's robot in a word, as telemetry has it."""
        if not self.is_there(now_ns):
            return "absent"
        return "driven" if self.ownership.owner is Owner.PARTNER else "ready"

    def poll_partner(self, *, stopped: bool) -> bytes | None:
        """Return the newest datagram for the partner's robot, or None; None while stopped here."""
        data, self._to_partner = self._to_partner, None
        return None if stopped else data

    def poll_joystick(self) -> bytes | None:
        """Return the newest datagram of the partner's robot for the joystick, or None."""
        data, self._to_joystick = self._to_joystick, None
        return data
