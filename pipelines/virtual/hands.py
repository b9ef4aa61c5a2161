"""What the loops of a simulated session's robot and joystick do every few cycles, as live ones."""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from pipelines.hand.hand_topics import JoystickStatus, unpack_status
from pipelines.hand.haptics import JoystickEnd, RobotEnd
from pipelines.hand.robot_commands import JoystickStatusTeller, RobotCommands
from pipelines.hand.safety_ends import CameraWatch, OperatorView
from pipelines.session.mission_messages import RobotCommand, RobotOrder, RobotStatus
from pipelines.session.setup.table import STEREO, Setup
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.envelope import Hold

_T = TypeVar("_T")


def _next(waiting: deque[_T]) -> _T | None:
    return waiting.popleft() if waiting else None


class RobotSeldom:
    """Call `handle_time` every `SELDOM` cycles.

    commands: by telecommand, with their instants. publish: called with each status that is due.
    orders: of a kernel, with their instants. status: what was published last. camera: the selected
    one. `handle_halves` is for the older half of a merged picture.
    """

    def __init__(
        self,
        setup: Setup,
        end: RobotEnd,
        service: RobotCommands,
        commands: deque[tuple[RobotCommand, int]],
        publish: Callable[[RobotStatus], object],
        *,
        now_ns: int,
    ) -> None:
        self.service, self._publish, self._envelope = service, publish, end.envelope
        self.orders: deque[tuple[RobotOrder, int]] = deque()
        self.status = service.status(now_ns)
        self.camera: str | None = None
        stale_ns = setup.stale_after_ns(setup.uplink_video)
        press = partial(end.envelope.require_press, Hold.CAMERA)
        self._watch = CameraWatch(STEREO, stale_ns, press)
        self.handle_halves = self._watch.handle_halves
        self._next_order = partial(_next, self.orders)
        self._next_command = partial(_next, commands)

    def handle_time(self, now_ns: int) -> None:
        status = self.service.serve(self._next_order, self._next_command, now_ns)
        if status is not None:
            self.status = status
            self._publish(status)
        if self.camera is not None:
            self._watch.handle_choice(self.camera)
        self._envelope.blind = self._watch.is_blind(now_ns)


class JoystickSeldom:
    """Call `handle_time` every `SELDOM` cycles.

    commands: by telecommand. publish: called with each state that is due.
    view: of the operator; None: nobody knows what is shown.
    """

    def __init__(
        self,
        end: JoystickEnd,
        commands: deque[bytes],
        publish: Callable[[JoystickStatus], object],
        *,
        view: OperatorView | None,
    ) -> None:
        self._handle, self._publish, self._view = end.side.handle, publish, view
        self._teller = None
        if isinstance(self._handle, OperatedHandle):
            self._teller = JoystickStatusTeller(self._handle)
            self._teller.handle_watched(watched=True)
        self._next_request: Callable[[], None] = lambda: None
        self._next_command = partial(_next, commands)

    def handle_time(self, now_ns: int) -> None:
        if self._teller is not None:
            octets = self._teller.serve(self._next_request, self._next_command, now_ns)
            status = None if octets is None else unpack_status(octets)
            if status is not None:
                self._publish(status)
        if self._view is not None:
            self._handle.blind = self._view.is_blind(now_ns)
