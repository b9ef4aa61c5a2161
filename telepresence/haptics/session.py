"""Sessions of the haptic exchange: which samples belong together, and to these two ends.

Samples of an earlier start, or replayed ones, must move nothing and grant no energy. So each sample
bears a session number, and an end uses only samples of its present session. A session begins with
an exchange in which each end sees a fresh number of its own come back, like the three-way handshake
of TCP (RFC 9293 section 3.5). docs/wire-formats.md has its steps.

Until then both ends go on with the session before, so a renewed session costs no gap. The joystick
renews a session before its sequence numbers or energies run out.
"""

from collections import deque

from kontur_av.clock import NS_PER_S
from telepresence.haptics.sample import LAST_SESSION, MOST_ENERGY_UJ, Greeting

#: Renew after half the time in which sequence numbers at 1 kHz wrap (65.5 s).
_RENEW_NS = 30 * NS_PER_S
#: Renew when half the energy that a sample can carry was granted.
_RENEW_UJ = MOST_ENERGY_UJ // 2
#: A joystick that has a session to send with puts a request in the place of every 20th sample.
_REQUEST_EVERY = 20
#: A robot in a session answers at most in the place of every 8th sample.
_ANSWER_EVERY = 8
#: After this many samples of another session and none of its own, the joystick asks anew, because
#: reordered offers can leave the ends in different sessions.
_STRAYS = 20
#: A robot tells so often, in samples, whether a partner's robot is there.
_PUBLISH_EVERY = 100
#: Offers that the robot remembers. More only come about by requests from more than one start.
_OFFERS = 8
#: Numbers of starts are below this.
BOOT_IDS = 1 << 24
_REQUESTS = 1 << 8


def _boot_id(number: int) -> int:
    if not 0 < number < BOOT_IDS:
        raise ValueError(f"the number of a life is 1 to {BOOT_IDS - 1}, not {number}")
    return number * _REQUESTS


def _after(session: int) -> int:
    return session % LAST_SESSION + 1


class JoystickSession:
    """The joystick's end; it asks.

    boot_id: a number from 1 to 2^24-1 that no earlier start of this end had; for the shell to draw.

    sending, receiving: session numbers of the samples that it sends and uses, 0 for none.
    restarts: how often the robot's life changed.
    strays: samples of other sessions since the last one of its own, for the caller to reset.
    for_partner: it asks a partner's robot. partner_there: the robot's newest greeting says that
    there is one.
    """

    def __init__(self, boot_id: int) -> None:
        self.sending = self.receiving = 0
        self.restarts = self.strays = 0
        self._boot_id = _boot_id(boot_id)
        self._requests = 0
        self._asking = True
        self._wait = 0
        self._renew_at_ns: int | None = None
        #: Numbers of the robot's life: in this session, in the offer, in the newest greeting.
        self._peer = self._offering = self._greeted = 0
        self.for_partner = self.partner_there = False

    def begin_anew(self, *, for_partner: bool) -> None:
        """Leave the session, and ask another robot for one."""
        self.sending = self.receiving = 0
        self._peer = self._offering = self._greeted = 0
        self._asking = False
        self._ask()
        self.for_partner, self.partner_there = for_partner, False

    def handle_greeting(self, greeting: Greeting) -> None:
        """The robot has no session, makes an offer, or tells of a partner's robot."""
        self._greeted = greeting.number
        self.partner_there = greeting.partner
        if not greeting.session:
            self._ask()
        elif self._asking and greeting.answers == self._number:
            self.sending, self._offering = greeting.session, greeting.number

    def handle_change(self, session: int) -> bool:
        """A sample with another number than `receiving` came; return whether to change over."""
        if not self._asking or session != self.sending:
            self.strays += 1
            if self.strays >= _STRAYS:
                self._ask()
            return False
        self.receiving = session
        self._asking = False
        self._renew_at_ns = None
        if self._peer not in (0, self._offering):
            self.restarts += 1
        self._peer = self._offering
        return True

    def poll_greeting(self, granted_uj: int, now_ns: int) -> Greeting | None:
        """Return the request to send in the place of a sample, or None. Call it for each sample.

        granted_uj: the larger of the totals of both directions in this session.
        """
        if not self._asking:
            if self._renew_at_ns is None:
                self._renew_at_ns = now_ns + _RENEW_NS
            if now_ns >= self._renew_at_ns or granted_uj > _RENEW_UJ:
                self._ask()
            else:
                return None
        if self.sending and self._wait:
            self._wait -= 1
            return None
        self._wait = _REQUEST_EVERY - 1
        return Greeting(self.sending, self._number, self._greeted, self.for_partner)

    @property
    def _number(self) -> int:
        return self._boot_id + self._requests

    def _ask(self) -> None:
        if not self._asking:
            self._asking = True
            self._requests = (self._requests + 1) % _REQUESTS
            self._wait = 0


class RobotSession:
    """The robot's end; it answers. Parameters and attributes as in `JoystickSession`.

    partner: whether a partner's robot is there, which the caller sets; None: there can be none.
    asking: number of the life that the newest request came from; 0 before the first.
    """

    def __init__(self, boot_id: int) -> None:
        self.sending = self.receiving = 0
        self.restarts = self.strays = self.asking = 0
        self._boot_id = _boot_id(boot_id)
        #: Session numbers by the number of the request.
        self._offers: dict[int, int] = {}
        self._offered = 0
        #: Numbers of samples of earlier sessions; more of them may be under way.
        self._strange: deque[int] = deque(maxlen=_OFFERS)
        self._answer: Greeting | None = None
        self._wait = 0
        self._peer = 0
        self.partner: bool | None = None
        self._untold = 0

    def handle_greeting(self, greeting: Greeting) -> None:
        """The joystick asks for a session."""
        number = greeting.number
        self.asking = number // _REQUESTS
        if greeting.answers != self._boot_id:
            # Meant for an earlier start, or from a joystick that has heard none.
            self._answer = Greeting(0, self._boot_id, number)
            return
        offer = self._offers.get(number)
        # One that asks again for the session that it has, and does not know it, lost its memory.
        if offer is None or (offer == self.receiving and offer != greeting.session):
            offer = self._new_session(greeting)
            self._offers.pop(number, None)
            self._offers[number] = offer
            if len(self._offers) > _OFFERS:
                del self._offers[next(iter(self._offers))]
        self._answer = Greeting(offer, self._boot_id, number)

    def handle_change(self, session: int) -> bool:
        """A sample with another number than `receiving` came; return whether to change over."""
        for number, offer in self._offers.items():
            if offer == session:
                self.sending = self.receiving = self._offered = session
                self._offers = {number: offer}
                boot_id = number // _REQUESTS
                if self._peer not in (0, boot_id):
                    self.restarts += 1
                self._peer = boot_id
                return True
        if session not in self._strange:
            self._strange.append(session)
        return False

    def poll_greeting(self, granted_uj: int, now_ns: int) -> Greeting | None:
        """Return the greeting to send in the place of a sample, or None. Call it for each sample.

        The joystick watches totals and time for both ends.
        """
        answer = self._answer
        if self.sending:
            if self._wait:
                self._wait -= 1
                return None
            if answer is None:
                return None if self.partner is None else self._publish_partner()
            self._wait = _ANSWER_EVERY - 1
        self._answer = None
        return (answer or Greeting(0, self._boot_id))._replace(partner=self.partner is True)

    def _publish_partner(self) -> Greeting | None:
        self._untold += 1
        if self._untold < _PUBLISH_EVERY:
            return None
        self._untold = 0
        return Greeting(self.sending, self._boot_id, partner=self.partner is True)

    def _new_session(self, greeting: Greeting) -> int:
        """Return a session number that no sample under way should have."""
        if self.receiving:
            session = _after(self._offered)
        elif greeting.session:
            session = _after(greeting.session)
        else:
            # Both ends began a life, so neither knows what was used before.
            session = _after((greeting.number + self._boot_id) // _REQUESTS)
        used = {greeting.session, self.receiving, *self._offers.values(), *self._strange}
        while session in used:
            session = _after(session)
        self._offered = session
        return session
