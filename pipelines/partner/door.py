"""Who may send to us and watch by WHIP and WHEP, and how many. A core."""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from pipelines.session.access import is_token

#: Requests of strangers that are answered in a second; further ones are turned away unread.
_STRANGERS_A_SECOND = 10
#: Offers of those who have the token, too: each costs a certificate and sockets.
_OFFERS_A_SECOND = 5


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a request is not served. status: of HTTP. words: for a person."""

    status: int
    words: str


class Door:
    """Admits requests with the bearer token (RFC 9725 section 4.7), within bounds.

    token: shared with the partner. most_viewers: that watch at once.

    There is one partner whose picture is taken: a newer connection takes the place of the older.
    """

    def __init__(self, *, token: str, most_viewers: int = 8) -> None:
        self._token = token
        self._most_viewers = most_viewers
        self._second_ns = 0
        self._strangers = self._offers = 0
        #: Requests refused, by reason.
        self.refused: dict[str, int] = {}

    def check(self, authorization: str | None, now_ns: int) -> Refusal | None:
        """Return None for a request with the token, else why it is refused.

        authorization: of the request's header.
        """
        self._begin_second(now_ns)
        kind, _, given = (authorization or "").partition(" ")
        if kind.lower() == "bearer" and is_token(given.strip(), self._token):
            return None
        self._strangers += 1
        if self._strangers > _STRANGERS_A_SECOND:
            return self._refuse("strangers", 429, "too many requests")
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

    def _refuse(self, reason: str, status: int, words: str) -> Refusal:
        self.refused[reason] = self.refused.get(reason, 0) + 1
        return Refusal(status, words)

    def _begin_second(self, now_ns: int) -> None:
        if now_ns - self._second_ns >= NS_PER_S:
            self._second_ns = now_ns
            self._strangers = self._offers = 0
