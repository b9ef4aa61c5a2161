"""The gateway application's desk: an operator hands the robot's haptic port over. A core.

A terminal's request is a line of JSON, `{"owner": "partner"}`; an empty owner only asks. The answer
is `{"ok": true, "owner": "iss", "wanted": "partner", ...}` or `{"ok": false, "error": "..."}`.

| topic | writer | content |
|---|---|---|
| `arm/order` | desk | who is to drive |
| `arm/state` | robot | `ArmState`: who drives |
"""

import msgspec

from pipelines.session.terminal_lines import LineDesk
from telepresence.haptics.ownership import Owner, OwnershipFigures

#: The name of its Unix socket.
DESK = "arm"
ORDER_OCTETS = max(len(owner.value) for owner in Owner)
STATE_OCTETS = 256
OWNERS = tuple(owner.value for owner in Owner)


class ArmState(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Who drives: "iss", "partner" or "" for nobody. waiting: for a released dead-man button."""

    owner: str = ""
    wanted: str = ""
    waiting: bool = False
    refused_iss: int = 0
    refused_partner: int = 0

    @classmethod
    def of(cls, figures: OwnershipFigures, *, waiting: bool) -> "ArmState":
        """Return the state in the figures of a port; waiting: for a new press."""
        return cls(
            owner="" if figures.owner is None else figures.owner.value,
            wanted=figures.wanted.value,
            waiting=waiting and figures.owner is not None,
            refused_iss=figures.refused[Owner.ISS.value],
            refused_partner=figures.refused[Owner.PARTNER.value],
        )

    def pack(self) -> bytes:
        """Return at most `STATE_OCTETS` octets."""
        return msgspec.msgpack.encode(self)

    @classmethod
    def unpack(cls, octets: bytes) -> "ArmState":
        """Return what `pack` packed. Only the session's own robot writes the topic."""
        return msgspec.msgpack.decode(octets, type=cls)


class OwnerRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What a terminal asks. owner: who is to drive, or "" to ask who does; not checked yet."""

    owner: object = ""


class OwnerAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The state, or why not. mistake: the request itself was wrong."""

    ok: bool
    error: str = ""
    mistake: bool = False
    owner: str = ""
    wanted: str = ""
    waiting: bool = False


class OwnerDesk:
    """Takes requests. After each input publish `order`.

    desk: takes them. order: who is to drive. It outlives the desk: give the last one at the start.
    """

    def __init__(self, order: Owner = Owner.ISS) -> None:
        self.order = order
        self._state = ArmState(wanted=order.value)
        self.desk = LineDesk(OwnerRequest, self._answer)

    def handle_state(self, state: ArmState) -> None:
        """The robot has told who drives."""
        self._state = state

    def _answer(self, request: OwnerRequest, _now_ns: int) -> OwnerAnswer:
        wanted = request.owner
        if wanted != "":
            if wanted not in OWNERS:
                error = f"no owner {wanted}: take {' or '.join(OWNERS)}"
                return OwnerAnswer(ok=False, error=error, mistake=True)
            self.order = Owner(wanted)
        state = self._state
        return OwnerAnswer(
            ok=True, owner=state.owner, wanted=self.order.value, waiting=state.waiting
        )
