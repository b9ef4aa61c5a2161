"""Who may open a page: tokens, and the checks of Host and Origin. A core.

Host is checked against DNS rebinding: a foreign name that resolves to this machine is refused.
Origin is checked because a browser lets any site open a WebSocket to any address.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from hmac import compare_digest

_STATIC_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}\.(?:js|css|html|svg)")
#: By the ending of a file's name.
CONTENT_TYPES: Mapping[str, str] = {
    "js": "text/javascript",
    "css": "text/css",
    "html": "text/html",
    "svg": "image/svg+xml",
}
#: In the HTML of a seat, the place of the address below which everything else lies.
BASE_MARK = "__BASE__"


class Role(Enum):
    """What the owner of a token may do."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Why a request is refused. reason: a key for the counters: `token`, `host` or `origin`."""

    reason: str
    text: str


class Gatekeeper:
    """Checks requests to one listener.

    scheme: "http" or "https". names: the hosts that a browser may ask for, in lower case.
    """

    def __init__(
        self,
        *,
        scheme: str,
        names: tuple[str, ...],
        port: int,
        operator_token: str,
        viewer_token: str,
    ) -> None:
        default = port == (443 if scheme == "https" else 80)
        bare = [f"[{name}]" if ":" in name else name for name in names]
        self._hosts = {f"{name}:{port}" for name in bare} | (set(bare) if default else set())
        self._scheme = scheme
        self._tokens = {
            Role.OPERATOR: operator_token.encode(),
            Role.VIEWER: viewer_token.encode(),
        }

    def role_of(self, token: str) -> Role | None:
        """Return what the owner of `token` may do; None for a wrong one."""
        given = token.encode("utf-8", "surrogateescape")
        # Both are compared in any case, so that the time tells nothing.
        matches = [role for role, known in self._tokens.items() if compare_digest(given, known)]
        return matches[0] if matches else None

    def refusal(
        self, *, token: str, host: str | None, origin: str | None, socket: bool
    ) -> Refusal | None:
        """Return why a request is refused, or None.

        origin: as the request has it; a WebSocket (`socket`) of a browser always has one.
        """
        asked = (host or "").lower()
        if asked not in self._hosts:
            return Refusal(reason="host", text="this host is not served here")
        own = f"{self._scheme}://{asked}"
        if (origin is not None or socket) and (origin or "").lower() != own:
            return Refusal(reason="origin", text="only the page itself may ask")
        if self.role_of(token) is None:
            return Refusal(reason="token", text="open the address that kontur-av has printed")
        return None


def is_static_name(name: str) -> bool:
    """Whether `name` may be that of a static file: no folders, no dots but the one of its type."""
    return _STATIC_NAME.fullmatch(name) is not None


def security_headers(scheme: str, host: str) -> dict[str, str]:
    """Return the headers of every answer. host: the Host of the request, checked."""
    sockets = f"{'wss' if scheme == 'https' else 'ws'}://{host}"
    policy = "; ".join(
        (
            "default-src 'none'",
            "script-src 'self'",
            "worker-src 'self'",
            "style-src 'self'",
            "img-src 'self' data: blob:",
            f"connect-src 'self' {sockets}",
            "media-src 'self' blob:",
            "base-uri 'self'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )
    return {
        "Content-Security-Policy": policy,
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Permissions-Policy": "camera=(self), microphone=(self), gamepad=(self)",
        "Cache-Control": "no-store",
    }
