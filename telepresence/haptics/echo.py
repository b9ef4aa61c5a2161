"""How old the commands that the robot gets are, without a common clock.

The robot puts a probe in the place of a sample; the joystick returns it in the place of its next
one. Samples that come after it are younger than the round trip. docs/wire-formats.md has the
octets.
"""

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.sample import UNKNOWN_AGE_MS, Echo

#: A probe goes in the place of a sample this often.
_EVERY_NS = 100 * NS_PER_MS
#: Probes that count as under way; more than a link's delay needs.
_MOST = 600
_NUMBERS = 1 << 32
#: Before the first answer.
ANY_AGE_NS = 1 << 62


class EchoProbe:
    """The robot's end. Call `poll_transmit` for each sample in a session.

    While an answer is missing, the age counts from the oldest probe without an answer. Before the
    first answer it is `ANY_AGE_NS`.

    answered: the joystick returns probes; the caller sets it. None is sent before.
    trip_ns: the newest round trip (ns), measured in the samples' own places; None before.
    """

    def __init__(self) -> None:
        self.answered = False
        #: Instants of the probes without an answer, by their numbers, oldest first.
        self._sent: dict[int, int] = {}
        self._number = 0
        self._due_ns = 0
        self.trip_ns: int | None = None

    def handle_echo(self, echo: Echo, now_ns: int) -> None:
        """The joystick has returned a probe. An unknown number is ignored."""
        sent_ns = self._sent.get(echo.number)
        if sent_ns is None:
            return
        self.trip_ns = now_ns - sent_ns
        while self._sent.pop(next(iter(self._sent))) != sent_ns:
            # Lost, or overtaken.
            pass

    def poll_transmit(self, now_ns: int) -> Echo | None:
        """Return the probe to send in the place of this sample, or None."""
        if not self.answered or now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + _EVERY_NS
        if len(self._sent) < _MOST:
            self._number = (self._number + 1) % _NUMBERS
            self._sent[self._number] = now_ns
        return Echo(self._number, min(self.age_ns(now_ns) // NS_PER_MS, UNKNOWN_AGE_MS))

    def age_ns(self, now_ns: int) -> int:
        """Return how old (ns) the newest command is at most, since the hand."""
        if self.trip_ns is None:
            return ANY_AGE_NS
        if not self._sent:
            return self.trip_ns
        waited_ns = now_ns - next(iter(self._sent.values()))
        return waited_ns if waited_ns > self.trip_ns + _EVERY_NS else self.trip_ns


class EchoReturn:
    """The joystick's end, which returns each probe.

    told_age_ms: how old its commands are at the robot, as the robot says; None if unknown.
    """

    def __init__(self) -> None:
        self.told_age_ms: int | None = None
        self._number: int | None = None

    def handle_echo(self, echo: Echo, _now_ns: int) -> None:
        """The robot's probe has come."""
        self._number = echo.number
        self.told_age_ms = None if echo.age_ms == UNKNOWN_AGE_MS else echo.age_ms

    def poll_transmit(self, _now_ns: int) -> Echo | None:
        """Return the probe to send back in the place of this sample, or None."""
        number, self._number = self._number, None
        return None if number is None else Echo(number)
