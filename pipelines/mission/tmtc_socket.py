"""How processes of a segment ask its TM/TC end."""

import time
from collections.abc import Iterator

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import replace_file, session_root
from pipelines.mission.tmtc_messages import (
    TMTC_TOPICS,
    CommandUpdate,
    FunctionAsked,
    FunctionDone,
    K2aciArrived,
    K2aciUpdate,
    Reported,
    SendCommand,
    SendK2aci,
    SetValues,
    TmtcNews,
    TmtcRequest,
    Values,
    k2aci_message,
    pack_request,
    plain_fields,
)
from pipelines.session.requests import post
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader
from telepresence.tmtc.k2aci import K2aciMessage
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.retransmission import Retransmission

#: In the session's directory.
_DICTIONARY = "dictionary.json"


def tmtc_socket_name(segment: Segment) -> str:
    return f"tmtc.{segment.value}"


TMTC_SOCKETS = tuple(tmtc_socket_name(segment) for segment in Segment)


def write_dictionary(session: str, dictionary: Dictionary) -> None:
    """Keep the dictionary of a session for those who ask it. Do so before it takes requests."""
    replace_file(session_root(session) / _DICTIONARY, msgspec.json.encode(dictionary))


def read_dictionary(session: str) -> Dictionary:
    """Return the dictionary of a running session, with its cameras and users' components.

    Raises ConfigError if the session has ended.
    """
    try:
        octets = (session_root(session) / _DICTIONARY).read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"session {session} has ended") from None
    return msgspec.json.decode(octets, type=Dictionary)


def send_to_tmtc(session: str, segment: Segment, request: TmtcRequest) -> bool:
    """Send a request to the TM/TC end of a segment, without waiting.

    Returns False if nobody takes it now; try again later. ConfigError for a request that is too
    long. What becomes of it comes on the topic `TMTC_TOPICS[segment]`.
    """
    return post(session, tmtc_socket_name(segment), pack_request(request))


_DEPTH = 32
#: A message that nobody has taken is handed over again at this interval.
_AGAIN_NS = 500_000_000
_MOST_WAITING = 64


class TmtcClient:
    """An application of a mission. Call `work` often.

    first_number: above those of earlier starts.
    """

    def __init__(
        self, bus: TopicBus, session: str, segment: Segment, application: str, *, first_number: int
    ) -> None:
        self._session, self._segment, self._application = session, segment, application
        self._client = f"{application} {first_number}"
        self._news = TopicReader(bus, TMTC_TOPICS[segment], depth=_DEPTH)
        self._waiting: Retransmission[K2aciMessage] = Retransmission(
            timeout_ns=_AGAIN_NS, most=_MOST_WAITING, longest=1
        )

    def send(self, message: K2aciMessage, now_ns: int) -> None:
        """Send a message to the application at the other end.

        The oldest of 64 messages that nobody has taken is dropped.
        """
        if self._waiting.full:
            self._waiting.pop(self._waiting.numbers[0])
        self._waiting.handle_put(message, now_ns)
        self._transmit(now_ns)

    def publish(self, values: Values) -> None:
        """The application's parameters have these values."""
        send_to_tmtc(self._session, self._segment, SetValues(self._application, values))

    def answer(self, asked: FunctionAsked, refusal: str) -> None:
        """A function was carried out, or refused for a reason."""
        done = FunctionDone(self._application, asked.token, refusal)
        send_to_tmtc(self._session, self._segment, done)

    def work(self, now_ns: int) -> Iterator[K2aciMessage | FunctionAsked]:
        """Yield what has come for this application."""
        while (news := self._news.next()) is not None:
            if isinstance(news, K2aciArrived):
                yield k2aci_message(news.kind, news.fields)
            elif isinstance(news, FunctionAsked) and news.application == self._application:
                yield news
            elif isinstance(news, K2aciUpdate) and news.client == self._client:
                self._waiting.pop(news.id)
        self._transmit(now_ns)

    def _transmit(self, now_ns: int) -> None:
        while (due := self._waiting.poll_transmit(now_ns)) is not None:
            number, message = due[0], due[1].item
            request = SendK2aci(self._client, number, type(message).__name__, plain_fields(message))
            send_to_tmtc(self._session, self._segment, request)


#: The end of a session says at once that it has the telecommand; else it is asked again.
_ASK_AGAIN_NS = NS_PER_S // 2
_TAKEN_NS = 3 * NS_PER_S
#: That end gives a telecommand up after 30 s.
_TIMEOUT_NS = 45 * NS_PER_S
_LOOK_NS = NS_PER_S // 20
#: What a telecommand asked for comes with its verification; reports may come a little later.
_REPORTS = {"report": "housekeeping", "parameters": "parameters"}


class Sending:
    """Sends a request until the end has taken it, then follows what is said of it."""

    def __init__(self, session: str, origin: Segment, request: SendCommand, bus: TopicBus) -> None:
        self.session, self._origin = session, origin
        self.request = request
        self._reader = TopicReader(bus, TMTC_TOPICS[origin], depth=_DEPTH)
        self._taken = False
        self._stage = ""
        #: The report that was asked for has come, or none was.
        self._reported = request.verb not in _REPORTS
        #: Its end, once it has come.
        self.done: CommandUpdate | None = None

    def news(self) -> Iterator[CommandUpdate | Reported]:
        """Yield what becomes of it, last its end; and the report that it asked for."""
        begun_ns = time.monotonic_ns()
        again_ns = end_ns = begun_ns
        while True:
            now_ns = time.monotonic_ns()
            if self.done is not None and (self._reported or now_ns >= end_ns):
                return
            if not self._taken and now_ns >= again_ns:
                again_ns = now_ns + _ASK_AGAIN_NS
                send_to_tmtc(self.session, self._origin, self.request)
            if now_ns - begun_ns > (_TIMEOUT_NS if self._taken else _TAKEN_NS):
                return
            self._reader.open().wait(_LOOK_NS)
            while (news := self._reader.next()) is not None:
                if (fresh := self._take(news)) is not None:
                    yield fresh
            if self.done is not None and end_ns == begun_ns:
                end_ns = time.monotonic_ns() + _ASK_AGAIN_NS if self.done.ok else now_ns

    def _take(self, news: TmtcNews) -> CommandUpdate | Reported | None:
        """Return news of this telecommand that were not told yet."""
        request = self.request
        if isinstance(news, CommandUpdate):
            if (news.client, news.id) != (request.client, request.id):
                return None
            self._taken = True
            known, self._stage = self._stage, news.stage
            self.done = news if news.done else None
            return None if news.stage == known else news
        if isinstance(news, Reported) and not self._reported:
            wanted = news.kind == _REPORTS[request.verb] and news.application == request.application
            if wanted and request.name in ("", news.name):
                self._reported = True
                return news
        return None
