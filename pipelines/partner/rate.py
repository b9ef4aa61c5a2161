"""How the picture for the partner is coded: rate by feedback, key pictures on request. Cores."""

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import Coding

#: The least rate: a coarse picture is better than none.
LEAST_BPS = 100_000
#: A wish at or above what is sent limits nothing: receivers name at most 1.5 times what comes.
_LIMITS_BELOW = 0.95
#: A change of rate costs a key picture, so it must be worth it, and come seldom.
_WORTH = 0.12
_LOWER_AGAIN_NS = NS_PER_S
_RAISE_AGAIN_NS = 4 * NS_PER_S
_RAISE = 1.25
#: The time in which coded octets leave at the rate; with more the picture is skipped.
_MOST_BACKLOG_NS = 150 * NS_PER_MS


class RateFollower:
    """The rate of the encoder, from what partners can take.

    most_bps: the usual rate. A partner's estimate above what is sent says nothing, because it saw
    no more; so it lowers the rate only below that, and the rate grows back by itself.
    """

    def __init__(self, *, most_bps: int) -> None:
        self._most_bps = most_bps
        self._least_bps = min(LEAST_BPS, most_bps)
        #: The present rate in bit/s.
        self.bps = most_bps
        self._changed_ns: int | None = None
        #: How often it was lowered.
        self.lowered = 0

    def handle_wish(self, wish_bps: int | None, sent_bps: float, now_ns: int) -> bool:
        """Return whether the rate changes. Call it a few times a second.

        wish_bps: the lowest estimate of the partners (REMB); None: none is known.
        sent_bps: what was sent over the last second.
        """
        passed_ns = None if self._changed_ns is None else now_ns - self._changed_ns
        limited = wish_bps is not None and wish_bps < sent_bps * _LIMITS_BELOW
        if limited:
            assert wish_bps is not None
            wanted = max(min(wish_bps, self._most_bps), self._least_bps)
            soon = passed_ns is not None and passed_ns < _LOWER_AGAIN_NS
            if soon or wanted > self.bps * (1 - _WORTH):
                return False
            self.lowered += 1
        else:
            if self.bps >= self._most_bps:
                return False
            if passed_ns is not None and passed_ns < _RAISE_AGAIN_NS:
                return False
            wanted = min(int(self.bps * _RAISE), self._most_bps)
        self.bps = wanted
        self._changed_ns = now_ns
        return True


class PicturePlan:
    """Decides for each picture whether and how to encode it.

    Call `handle_picture` for each; encode it with the `Coding`, then call `handle_coded`.
    bps: the rate at first. skipped: pictures that were left out.
    """

    def __init__(self, *, bps: int) -> None:
        self._bps = self._coded_bps = bps
        self._key = True
        self._free_ns = 0
        self.skipped = 0

    def handle_rate(self, bps: int) -> None:
        """The encoder shall have this rate from now on."""
        self._bps = bps

    def handle_key_request(self) -> None:
        """A partner needs a key picture."""
        self._key = True

    def handle_picture(self, now_ns: int) -> Coding | None:
        """Return how to encode the picture that has come, or None to skip it."""
        if self._free_ns - now_ns > _MOST_BACKLOG_NS:
            self.skipped += 1
            return None
        cap_bps = None if self._bps == self._coded_bps else self._bps
        self._coded_bps = self._bps
        coding = Coding(keyframe=self._key, cap_bps=cap_bps)
        self._key = False
        return coding

    def handle_coded(self, octets: int, now_ns: int) -> None:
        """The picture has become so many octets."""
        self._free_ns = max(self._free_ns, now_ns) + octets * 8 * NS_PER_S // self._bps
