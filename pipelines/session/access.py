"""The people of a session, what each may open and ask for, and how many stay connected. A core.

A token in the address identifies the user; the host must be a name of the seat. The connection
of a client without a token is closed after `UNAUTHENTICATED_NS`, and the oldest such one makes
room for a new one. So idle connections take few descriptors, and never keep out a user with
a token.
"""

import hmac
import re
from collections.abc import Iterable, Mapping
from enum import Enum
from ipaddress import ip_address
from types import MappingProxyType
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.k2aci import ChatRole


class Role(Enum):
    """What a page may do, by its token. The operator may do what all people of its end may."""

    OPERATOR = "operator"
    COSMONAUT = "cosmonaut"
    EXPERIMENTER = "experimenter"
    SUPERVISOR = "supervisor"
    SYSTEMS = "systems"
    TRAINER = "trainer"
    VIEWER = "viewer"

    @property
    def words(self) -> str:
        return "systems operator" if self is Role.SYSTEMS else self.value


#: By end: its people, besides the session's owner, its trainer and those who watch.
PEOPLE: Mapping[Segment, tuple[Role, ...]] = {
    Segment.SPACE: (Role.COSMONAUT,),
    Segment.GROUND: (Role.EXPERIMENTER, Role.SUPERVISOR, Role.SYSTEMS),
}

VIEWER_WORDS = "a viewer may watch only"

_JOYSTICK = (
    *("calibrate", "start", "start_russian", "stop", "halt", "resume", "acknowledge", "test"),
    *("policy", "person"),
)
#: Who may do what. Telecommands are named APPLICATION.FUNCTION, those of reports `housekeeping`.
_MAY: Mapping[str, tuple[Role, ...]] = {
    "hand": (Role.COSMONAUT,),
    "joystick": (Role.COSMONAUT,),
    "session": (Role.COSMONAUT, Role.SUPERVISOR),
    "record": PEOPLE[Segment.GROUND],
    "chat": (*PEOPLE[Segment.SPACE], *PEOPLE[Segment.GROUND]),
    "housekeeping": (Role.SUPERVISOR, Role.SYSTEMS),
    **{f"joystick.{name}": (Role.COSMONAUT, Role.SUPERVISOR) for name in _JOYSTICK},
    **{f"camera.{name}": (Role.COSMONAUT,) for name in ("select", "focus")},
    "panel.button": (Role.COSMONAUT,),
    "tasks.select": (Role.EXPERIMENTER,),
    "tasks.start": (Role.EXPERIMENTER,),
    "tasks.abort": (Role.EXPERIMENTER, Role.SUPERVISOR),
    **{
        f"{end}_supervisor.{name}": (Role.SUPERVISOR, Role.SYSTEMS)
        for end in ("space", "ground")
        for name in ("start", "stop")
    },
    "robot.power_on": (Role.EXPERIMENTER,),
    "robot.power_off": (Role.EXPERIMENTER, Role.SUPERVISOR),
    "robot.set_mode": (Role.EXPERIMENTER,),
    "robot.reset_error": (Role.EXPERIMENTER,),
    "robot.emergency_stop": (*PEOPLE[Segment.SPACE], *PEOPLE[Segment.GROUND]),
    "robot.release_stop": (Role.COSMONAUT, Role.SUPERVISOR),
    "fetch": (Role.SUPERVISOR, Role.SYSTEMS),
    "exercise": (Role.TRAINER,),
}


def refusal(role: Role, segment: Segment, deed: str) -> str:
    """Return why `role` at a page of `segment` may not do this; "" if it may.

    deed: what a page asks for, or of a telecommand `housekeeping` or APPLICATION.FUNCTION.
    """
    if role is Role.VIEWER:
        return VIEWER_WORDS
    may = _MAY.get(deed, ())
    given = PEOPLE[segment] if role is Role.OPERATOR else (role,)
    if any(one in may for one in given):
        return ""
    asked = deed.replace(".", " ").replace("_", " ")
    who = " or ".join(f"the {one.words}" for one in may) or "nobody"
    you = f"people in {segment.value}" if role is Role.OPERATOR else f"the {role.words}"
    if role is Role.OPERATOR and segment is Segment.GROUND:
        you = "people on the ground"
    return f"{asked}: {who} may, not {you}"


def place_name(role: Role, segment: Segment) -> str:
    """Return who sits at a page, as the others of its end read it."""
    ground = segment is Segment.GROUND
    return "ground control" if role is Role.OPERATOR and ground else role.words


def chat_role(role: Role, segment: Segment) -> ChatRole:
    """As whom a page writes in the chat."""
    if role is Role.OPERATOR:
        return ChatRole.COSMONAUT if segment is Segment.SPACE else ChatRole.OPERATOR
    return ChatRole.OPERATOR if role is Role.SYSTEMS else ChatRole(role.value)


_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_DEFAULT_PORTS = {"http": 80, "https": 443}
_FILE = re.compile(r"[a-z0-9_]+(?:\.[a-z0-9]+)+")


class AccessKind(Enum):
    """What is asked for."""

    PAGE = "page"
    FILE = "file"
    SEAT = "seat"
    MEDIA = "media"


class Found(NamedTuple):
    """What a request may have. token: the one in its address. name: of the page or file."""

    kind: AccessKind
    role: Role
    token: str
    name: str = ""


class AccessError(Exception):
    """A request that is not served. status: of HTTP. reason: for the counters, or ""."""

    def __init__(self, status: int, words: str, reason: str = "") -> None:
        super().__init__(words)
        self.status = status
        self.reason = reason


class Access:
    """Checks the requests to one seat.

    seat: the name of its page. others: names of its other pages. scheme, port: of its listener.
    names: the hosts that a browser may ask for, in lower case and without brackets; none: loopback.
    role_tokens: of the people of its end, by their role's value.

    Beyond loopback any IP address may be asked for. Only names can be rebound by another site.
    """

    def __init__(
        self,
        *,
        seat: str,
        scheme: str,
        port: int,
        names: Iterable[str],
        operator_token: str,
        viewer_token: str,
        role_tokens: Mapping[str, str] = MappingProxyType({}),
        others: Iterable[str] = (),
    ) -> None:
        self._seats = {seat, *others}
        self._scheme = scheme
        self._port = port
        self._names = frozenset(names) or frozenset(_LOOPBACK)
        self._far = not all(_is_loopback(name) for name in self._names)
        self._tokens = {
            Role.OPERATOR: operator_token,
            Role.VIEWER: viewer_token,
            **{Role(role): token for role, token in role_tokens.items()},
        }

    def find(self, method: str, target: str, host: str, origin: str | None) -> Found:
        """Return what a request may have, or raise `AccessError`.

        target: path and query as they came, not decoded. host, origin: of its header fields.
        """
        if not self._is_own(host):
            raise AccessError(403, "this seat has another name", "host")
        path, _, query = target.partition("?")
        parts = path.split("/")[1:]
        if len(parts) == 1 and parts[0] in self._seats:
            fields = (field.partition("=") for field in query.split("&"))
            token = next((value for name, _, value in fields if name == "token"), "")
            kind, name = AccessKind.PAGE, parts[0]
        elif len(parts) == 3 and parts[1] == "static":
            kind, token, name = AccessKind.FILE, parts[0], parts[2]
        elif len(parts) == 2 and parts[1] in ("ws", "media"):
            kind = AccessKind.SEAT if parts[1] == "ws" else AccessKind.MEDIA
            token, name = parts[0], ""
        else:
            # An unknown sender is not told whether a path exists.
            kind, token, name = AccessKind.FILE, parts[0] if parts else "", ""
        role = self._role_of(token)
        if role is None:
            raise AccessError(403, "this address needs the token of the session", "token")
        if method != "GET":
            raise AccessError(405, "only GET")
        # Other origins' pages can open sockets here, and they know no token but a stolen one.
        own = f"{self._scheme}://{host}".lower()
        if kind in (AccessKind.SEAT, AccessKind.MEDIA) and (origin or "").lower() != own:
            raise AccessError(403, "another site's page may not connect", "origin")
        if kind is AccessKind.FILE and not _FILE.fullmatch(name):
            raise AccessError(404, "no such file")
        return Found(kind, role, token, name)

    def _is_own(self, host: str) -> bool:
        match = re.fullmatch(r"(\[[0-9a-f:.]+\]|[a-z0-9.-]+)(?::(\d{1,5}))?", host.lower())
        if match is None:
            return False
        port = _DEFAULT_PORTS[self._scheme] if match[2] is None else int(match[2])
        name = match[1].strip("[]")
        return port == self._port and (name in self._names or (self._far and _is_address(name)))

    def _role_of(self, token: str) -> Role | None:
        # Each is compared in full, so that the time tells nothing.
        found = [role for role, own in self._tokens.items() if is_token(token, own)]
        return found[0] if token and found else None


def is_token(given: str, own: str) -> bool:
    """Whether an unknown sender has given the token, compared in constant time."""
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), own.encode())


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(name: str) -> bool:
    return ip_address(name).is_loopback if _is_address(name) else name == "localhost"


def headers(host: str) -> dict[str, str]:
    """Return the header fields of every answer. host: of the request, checked."""
    policy = (
        "default-src 'none'",
        "script-src 'self'",
        "worker-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        f"connect-src 'self' ws://{host} wss://{host}",
        "media-src 'self' blob:",
        "base-uri 'self'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
    return {
        "Content-Security-Policy": "; ".join(policy),
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Permissions-Policy": "camera=(self), microphone=(self), gamepad=(self)",
        "Cache-Control": "no-store",
    }


#: Connections in all; of unknown senders in all, and from one address; of those who only watch.
MOST_CONNECTIONS, MOST_UNAUTHENTICATED, MOST_OF_ADDRESS, MOST_WATCHING = 256, 64, 32, 128
#: An unknown sender's longest time, and the longest that TLS may take to agree on keys.
UNAUTHENTICATED_NS = 10 * NS_PER_S
HANDSHAKE_S = 5.0


class ConnectionLimits:
    """Connections by numbers that the caller chooses. Close those that the methods return.

    closed: connections that were closed so far, to make room or for their time.
    """

    def __init__(self) -> None:
        self.closed = 0
        #: By number, oldest first: address, and when it came.
        self._unauthenticated: dict[int, tuple[str, int]] = {}
        #: By number, oldest first: whether it only watches.
        self._known: dict[int, bool] = {}

    def __len__(self) -> int:
        return len(self._unauthenticated) + len(self._known)

    def handle_accepted(self, number: int, address: str, now_ns: int) -> list[int]:
        """A connection has come; return those to close, which may be itself."""
        self._unauthenticated[number] = (address, now_ns)
        closing = []
        same = [one for one, (host, _) in self._unauthenticated.items() if host == address]
        if len(same) > MOST_OF_ADDRESS:
            closing.append(same[0])
        elif len(self._unauthenticated) > MOST_UNAUTHENTICATED or len(self) > MOST_CONNECTIONS:
            closing.append(next(iter(self._unauthenticated)))
        return self._close(closing)

    def handle_known(self, number: int, *, watches: bool = False) -> list[int]:
        """A connection has shown a token; return those to close. watches: the token does no more.

        So viewers never take the connections of operators.
        """
        if self._unauthenticated.pop(number, None) is None:
            return []
        self._known[number] = watches
        watching = [one for one, only in self._known.items() if only]
        return self._close(watching[: max(0, len(watching) - MOST_WATCHING)])

    def handle_closed(self, number: int) -> None:
        self._unauthenticated.pop(number, None)
        self._known.pop(number, None)

    def handle_time(self, now_ns: int) -> list[int]:
        """Return the connections of unknown senders whose time is over."""
        return self._close(
            [
                one
                for one, (_, since) in self._unauthenticated.items()
                if now_ns - since >= UNAUTHENTICATED_NS
            ]
        )

    def _close(self, closing: list[int]) -> list[int]:
        for number in closing:
            self.handle_closed(number)
        self.closed += len(closing)
        return closing
