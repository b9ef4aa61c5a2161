"""An open page of a seat: what waits for it, and how much it may ask."""

from dataclasses import dataclass, field

from pipelines.seats.client_queue import ClientQueue
from pipelines.seats.rates import MessageRate
from pipelines.session.seat_roles import Role

_TEXT_HZ = _PING_HZ = 20
_HAND_HZ = 1200


@dataclass
class OpenPage:
    """A page that is open. plain: without pictures, sound and haptics.

    idle: it has taken all that there was, so it would take more at once.
    """

    number: int
    role: Role
    queue: ClientQueue
    plain: bool = False
    idle: bool = True
    texts: MessageRate = field(default_factory=lambda: MessageRate(_TEXT_HZ, _TEXT_HZ))
    pings: MessageRate = field(default_factory=lambda: MessageRate(_PING_HZ, _PING_HZ))
    hands: MessageRate = field(default_factory=lambda: MessageRate(_HAND_HZ, _HAND_HZ))
