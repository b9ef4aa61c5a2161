"""STUN and TURN servers, and credentials that end by themselves. A core.

coturn's REST API (draft-uberti-behave-turn-rest-00): the user name is the Unix time at which it
ends, a colon and any name; the password is the Base64 of its HMAC-SHA1 under a shared secret.
"""

import base64
import hmac
import re
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from kontur_av.errors import ConfigError

if TYPE_CHECKING:
    from aiortc import RTCIceServer

#: How long credentials last. A connection that stands longer asks for new ones when ICE restarts.
LASTING_S = 3600
_URL = re.compile(
    r"(?:stun:|turns?:)(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]{1,253})(?::\d{1,5})?"
    r"(?:\?transport=(?:udp|tcp))?"
)
_LEAST_SECRET_OCTETS = 8


@dataclass(frozen=True, kw_only=True)
class IceServer:
    """A server. username, credential: of TURN; "" for STUN."""

    url: str
    username: str = ""
    credential: str = ""

    def __post_init__(self) -> None:
        if _URL.fullmatch(self.url) is None:
            raise ConfigError(
                f"--ice-server {self.url!r}: write stun:HOST[:PORT] or turn:HOST[:PORT]"
            )
        if self.url.startswith("turn") and not (self.username and self.credential):
            raise ConfigError(
                f"--ice-server {self.url!r}: TURN needs credentials; give --turn-secret-file FILE, "
                "or --turn-user NAME and --turn-password-file FILE"
            )


@dataclass(frozen=True, kw_only=True)
class IceServers:
    """The servers of a connection. relay_only: go through TURN only; then `check` before use."""

    servers: tuple[IceServer, ...] = ()
    relay_only: bool = False

    def check(self) -> None:
        """ConfigError if no server can relay, although nothing else is wanted."""
        if self.relay_only and not any(server.url.startswith("turn") for server in self.servers):
            raise ConfigError("--ice-relay-only: give --ice-server turn:HOST, too")

    def for_aiortc(self) -> "list[RTCIceServer]":
        from aiortc import RTCIceServer  # takes 0.13 s

        return [
            RTCIceServer(
                urls=one.url, username=one.username or None, credential=one.credential or None
            )
            for one in self.servers
        ]

    def link_headers(self) -> list[str]:
        """Return the servers as values of HTTP's Link header (RFC 9725 section 4.6)."""
        links = []
        for server in self.servers:
            link = f'<{server.url}>; rel="ice-server"'
            if server.username:
                link += f'; username="{server.username}"; credential="{server.credential}"'
                link += '; credential-type="password"'
            links.append(link)
        return links


def timed_credentials(secret: str, *, name: str, now_s: int) -> tuple[str, str]:
    """Return user name and password of a TURN server that shares `secret` with us.

    now_s: Unix time. Raises ConfigError for a secret that is too short.
    """
    if len(secret) < _LEAST_SECRET_OCTETS:
        raise ConfigError(f"the TURN secret is too short: give {_LEAST_SECRET_OCTETS} octets")
    username = f"{now_s + LASTING_S}:{name}"
    digest = hmac.digest(secret.encode(), username.encode(), "sha1")
    return username, base64.b64encode(digest).decode()


_LINK = re.compile(r"<([^<>]{1,512})>((?:\s*;\s*[a-z-]+=(?:\"[^\"]{0,512}\"|[^\s\";,]{1,512}))*)")
_PARAMETER = re.compile(r";\s*([a-z-]+)=(?:\"([^\"]*)\"|([^\s\";,]+))")


def servers_of_links(values: list[str]) -> tuple[IceServer, ...]:
    """Return the servers that a media server names in Link headers; others are left out."""
    found = []
    for value in values[:16]:
        for url, rest in _LINK.findall(value[:4096]):
            parameters = {name: quoted or bare for name, quoted, bare in _PARAMETER.findall(rest)}
            if parameters.get("rel") != "ice-server":
                continue
            user, word = parameters.get("username", ""), parameters.get("credential", "")
            with suppress(ConfigError):
                found.append(IceServer(url=url, username=user, credential=word))
    return tuple(found[:4])
