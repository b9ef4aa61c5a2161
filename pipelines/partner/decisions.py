"""What the leg to a partner decides: when to connect, whom to admit, how to code. Cores."""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import Coding
from kontur_av.meters import RateMeter
from pipelines.session.access import is_token
from pipelines.session.topic import Topic

_FIRST_NS = 500 * NS_PER_MS
_LONGEST_NS = 30 * NS_PER_S
#: A connection that lasted this long was good: the next attempt comes soon.
_GOOD_NS = 10 * NS_PER_S
#: A restart of ICE that brings nothing for this long is given up for a new connection.
_RESTART_NS = 8 * NS_PER_S


class Doing(Enum):
    """What the connection does."""

    WAITING = "waiting"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    RESTARTING = "restarting ICE"


class Attempts:
    """Decides when to connect, to restart ICE, and to begin anew.

    1. At `poll_timeout` call `poll_connect`; if it returns True, begin a connection.
    2. Tell `handle_connected` or `handle_ended`.
    3. While connected, call `poll_restart` with whether the partner is silent. If it returns True,
       restart ICE. If `is_hopeless`, end the connection.
    """

    def __init__(self) -> None:
        self.doing = Doing.WAITING
        self._due_ns = 0
        self._wait_ns = _FIRST_NS
        self._since_ns = 0
        #: Connections begun, those that stood, restarts of ICE.
        self.begun = self.stood = self.restarts = 0

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_connect`; None while there is a connection."""
        return self._due_ns if self.doing is Doing.WAITING else None

    def poll_connect(self, now_ns: int) -> bool:
        if self.doing is not Doing.WAITING or now_ns < self._due_ns:
            return False
        self.doing = Doing.CONNECTING
        self.begun += 1
        return True

    def handle_connected(self, now_ns: int) -> None:
        if self.doing is Doing.CONNECTING:
            self.stood += 1
            self._since_ns = now_ns
        self.doing = Doing.CONNECTED

    def handle_ended(self, now_ns: int) -> None:
        """The connection has ended, or could not be made. The next one waits ever longer."""
        stood = self.doing in (Doing.CONNECTED, Doing.RESTARTING)
        if stood and now_ns - self._since_ns >= _GOOD_NS:
            self._wait_ns = _FIRST_NS
        self.doing = Doing.WAITING
        self._due_ns = now_ns + self._wait_ns
        self._wait_ns = min(self._wait_ns * 2, _LONGEST_NS)

    def poll_restart(self, *, silent: bool, now_ns: int) -> bool:
        """Return whether to restart ICE now. silent: nothing comes from the partner."""
        if self.doing is Doing.RESTARTING and not silent:
            self.doing = Doing.CONNECTED
        if self.doing is not Doing.CONNECTED or not silent:
            return False
        self.doing = Doing.RESTARTING
        self.restarts += 1
        self._restarted_ns = now_ns
        return True

    def is_hopeless(self, now_ns: int) -> bool:
        """Return whether a restart of ICE has brought nothing for too long."""
        return self.doing is Doing.RESTARTING and now_ns - self._restarted_ns > _RESTART_NS

    _restarted_ns = 0


#: Requests of unknown senders that are answered in a second; further ones are turned away unread.
_UNKNOWN_SENDERS_A_SECOND = 10
#: Offers of those who have the token, too: each costs a certificate and sockets.
_OFFERS_A_SECOND = 5
#: Who steers tells that it is there twice a second; one that is silent for longer gives way.
_HAND_SILENT_NS = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a request is not served. status: of HTTP. words: for a person."""

    status: int
    words: str


class Admission:
    """Admits requests with a bearer token (RFC 9725 section 4.7), within bounds.

    token: to watch and to send. hand_token: to steer; "": nobody steers.
    most_viewers: that watch at once.

    There is one partner whose picture is taken: a newer connection takes the place of the older.
    """

    def __init__(self, *, token: str, hand_token: str = "", most_viewers: int = 8) -> None:
        self._token, self._hand_token = token, hand_token
        self._most_viewers = most_viewers
        self._second_ns = 0
        self._unauthenticated = self._offers = 0
        #: Requests refused, by reason.
        self.refused: dict[str, int] = {}

    def check(
        self, authorization: str | None, now_ns: int, *, steers: bool | None = False
    ) -> Refusal | None:
        """Return None for a request with the token that it needs, else why it is refused.

        authorization: of the request's header. steers: whether it needs the token to steer; None:
        either will do.
        """
        self._begin_second(now_ns)
        kind, _, given = (authorization or "").partition(" ")
        named = given.strip() if kind.lower() == "bearer" else ""
        watcher = is_token(named, self._token)
        hand = bool(self._hand_token) and is_token(named, self._hand_token)
        if (watcher and steers is not True) or (hand and steers is not False):
            return None
        if watcher or hand:
            may = "watch and send" if watcher else "steer"
            return self._refuse("token", 403, f"this token may only {may}: take the other one")
        self._unauthenticated += 1
        if self._unauthenticated > _UNKNOWN_SENDERS_A_SECOND:
            return self._refuse("unknown_senders", 429, "too many requests")
        return self._refuse("token", 401, "this address needs the token")

    def check_offer(self, *, viewers: int | None, now_ns: int) -> Refusal | None:
        """Return None if a new connection may be made.

        viewers: that watch now; None for a partner that sends.
        """
        self._begin_second(now_ns)
        self._offers += 1
        if self._offers > _OFFERS_A_SECOND:
            return self._refuse("offers", 429, "too many offers")
        if viewers is not None and viewers >= self._most_viewers:
            return self._refuse("viewers", 503, f"{self._most_viewers} watch already")
        return None

    def check_hand(self, *, heard_ns: int | None, lent: bool, now_ns: int) -> Refusal | None:
        """Return None if a new connection may steer.

        heard_ns: when something last came by the present one; None: there is none.
        lent: the owner lets partners drive, so who drives is not displaced by another.
        """
        if not lent or heard_ns is None or now_ns - heard_ns > _HAND_SILENT_NS:
            return None
        words = "another one drives: it leaves, or the owner takes the robot back"
        return self._refuse("hand", 409, words)

    def _refuse(self, reason: str, status: int, words: str) -> Refusal:
        self.refused[reason] = self.refused.get(reason, 0) + 1
        return Refusal(status, words)

    def _begin_second(self, now_ns: int) -> None:
        if now_ns - self._second_ns >= NS_PER_S:
            self._second_ns = now_ns
            self._unauthenticated = self._offers = 0


#: The least rate: a coarse picture is better than none.
LEAST_BPS = 100_000
#: A request at or above what is sent limits nothing: receivers name at most 1.5 times what comes.
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

    def handle_request(self, requested_bps: int | None, sent_bps: float, now_ns: int) -> bool:
        """Return whether the rate changes. Call it a few times a second.

        requested_bps: the lowest estimate of the partners (REMB); None: none is known.
        sent_bps: what was sent over the last second.
        """
        passed_ns = None if self._changed_ns is None else now_ns - self._changed_ns
        limited = requested_bps is not None and requested_bps < sent_bps * _LIMITS_BELOW
        if limited:
            assert requested_bps is not None
            wanted = max(min(requested_bps, self._most_bps), self._least_bps)
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
        self._bps = bps

    def handle_key_request(self) -> None:
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
        self._free_ns = max(self._free_ns, now_ns) + octets * 8 * NS_PER_S // self._bps


class CodingRequest(NamedTuple):
    """How to code the picture for partners.

    bps: its rate; 0: nobody watches. keys: grows with each key picture that is wanted.
    """

    bps: int
    keys: int


RTC_REQUEST_TOPIC = Topic[CodingRequest](
    "rtc/request", CodingRequest, "rate and key pictures that the partner asks for"
)


class UplinkRequest:
    """What to tell the process that codes for partners, and when its picture lacks a part.

    rate: the rate that partners can take.
    """

    def __init__(self, *, most_bps: int) -> None:
        self.rate = RateFollower(most_bps=most_bps)
        self._sent = RateMeter()
        self._keys = 0
        self._next: int | None = None

    def handle_unit(self, sequence: int, octets: int, *, key: bool, now_ns: int) -> bool:
        """A coded unit goes to partners; return whether a key picture is wanted now.

        Between the processes units may be lost: what refers to them is damaged.
        """
        wanted = self._next is not None and sequence != self._next and not key
        self._next = sequence + 1
        self._sent.add(now_ns, octets)
        self._keys += wanted
        return wanted

    def handle_key_wanted(self) -> None:
        self._keys += 1

    def handle_time(self, requested_bps: int | None, now_ns: int) -> None:
        """Follow the lowest estimate of the partners, as `RateFollower.handle_request`."""
        self.rate.handle_request(requested_bps, self._sent.last_bps(now_ns), now_ns)

    def request(self, *, watched: bool) -> CodingRequest:
        """Return the request of now. watched: a partner is connected."""
        return CodingRequest(self.rate.bps if watched else 0, self._keys)
