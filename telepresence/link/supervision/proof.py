"""Fresh numbers: who echoes one that was drawn just now hears this end, and is there now.

A stream of frames that this end does not follow may be a peer that has restarted, or a stray, an
old recording, a guess. So this end asks by a HELLO with a number that it has never sent before.
Only an echo of it makes the stream the peer's (`Supervisor.handle_stranger`).

The numbers keep out everybody who does not read the frames of this end. They are no signature: who
reads both ways can answer as well as the peer.
"""

from random import Random

from telepresence.link.supervision.configuration import SupervisionTiming
from telepresence.link.supervision.message import NUMBER_BITS


class Proof:
    """One end's questions and answers.

    seed: of the numbers; nobody else may know it.
    proven: the stream that is followed has echoed a number.
    question: the number to echo, which came last; 0 without any.
    echoed: the number that was echoed last.
    """

    def __init__(self, seed: int, timing: SupervisionTiming) -> None:
        self.proven = False
        self.question = self.echoed = 0
        self._random = Random(seed)
        #: A number may be asked for a round trip, and its echo may take another.
        self._life_ns = timing.round_trip_ns
        self._number = self._last = 0
        self._drawn_ns = 0

    def number(self, now_ns: int) -> int:
        """The number to ask for now."""
        age_ns = now_ns - self._drawn_ns
        if not self._number or age_ns >= self._life_ns:
            self._last = self._number if age_ns < 2 * self._life_ns else 0
            self._number = 1 + self._random.randrange((1 << NUMBER_BITS) - 1)
            self._drawn_ns = now_ns
        return self._number

    def answers(self, echo: int, now_ns: int) -> bool:
        """Whether `echo` answers a question that is not too old. Each question counts once."""
        age_ns = now_ns - self._drawn_ns
        if not echo or not (
            (echo == self._number and age_ns < 2 * self._life_ns)
            or (echo == self._last and age_ns < self._life_ns)
        ):
            return False
        self._number = self._last = 0
        return True
