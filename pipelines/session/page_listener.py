"""Where a segment's browser pages are served, and who may open them."""

import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class PageListener:
    """A bound TCP socket, kept by the launcher, so that a restarted process has the same port.

    scheme: "http" or "https". host: as the printed address has it. port: as bound.
    names: the hosts, in lower case and without brackets, that a browser may ask for.
    operator_token, viewer_token: who has it may command, or only watch.
    role_tokens: of the people of this end, by the value of their `Role`.
    certificate: PEM file with certificate and key, for "https".
    """

    socket: socket.socket
    scheme: str
    host: str
    port: int
    names: tuple[str, ...] = ()
    operator_token: str = field(repr=False)
    viewer_token: str = field(repr=False)
    certificate: Path | None = None
    role_tokens: Mapping[str, str] = field(default_factory=dict, repr=False)

    def url(self, seat: str, *, viewer: bool = False, role: str = "") -> str:
        """Return the address of a page, such as "space" or "top". role: whose token it has."""
        token = self.viewer_token if viewer else self.operator_token
        if role:
            token = self.role_tokens[role]
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}/{seat}?token={token}"
