"""What a seat's process is to do, as `Seat.next_event` returns it."""

from typing import NamedTuple

from pipelines.hand.hand_topics import HandRequest
from pipelines.mission.tmtc_messages import TmtcRequest
from pipelines.session.session_switch import Order
from telepresence.haptics.device.page import PageInput


class HandMoved(NamedTuple):
    """What to tell the joystick of the hand."""

    hand: PageInput


class CommandGiven(NamedTuple):
    """A command for the joystick."""

    request: HandRequest


class SessionOrdered(NamedTuple):
    """The launcher is to stop or to start the session."""

    order: Order


class RecordingAsked(NamedTuple):
    """The recorder is to begin or to end; pass its answer to `Seat.handle_recorder`."""

    page: int
    request: int
    begin: bool


class TmtcAsked(NamedTuple):
    """The TM/TC end of this segment is to be told this."""

    request: TmtcRequest


SeatEvent = HandMoved | CommandGiven | SessionOrdered | RecordingAsked | TmtcAsked
