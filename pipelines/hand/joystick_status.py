"""The joystick's process and its operator: commands that come in, and the state that is told."""

from kontur_av.clock import NS_PER_MS
from pipelines.hand.hand_topics import (
    MOST_CHARACTERS,
    AxisStatus,
    JoystickStatus,
    pack_status,
    unpack_request,
)
from pipelines.hand.haptic_trace import WatchedTopic
from telepresence.haptics.device.handle import OperatedHandle

#: An unchanged state is told at this interval.
_ANEW_NS = 100 * NS_PER_MS

_Answer = tuple[int | None, str]


class JoystickStatusTeller(WatchedTopic):
    """Call `handle_request` for each request and `poll_status` every few cycles.

    The state is told only while it has readers: at each change, and every 100 ms.
    """

    def __init__(self, handle: OperatedHandle) -> None:
        super().__init__()
        self._handle = handle
        self._told: tuple[object, ...] | None = None
        self._anew_ns = 0
        #: Number of the newest command, and why it was refused: of persons, and by telecommand.
        self._answered: _Answer = (None, "")
        self._commanded: _Answer = (None, "")

    def handle_request(self, data: bytes) -> None:
        """Carry out the command in `data`; malformed input is ignored."""
        self._answered = self._carried_out(data) or self._answered

    def handle_telecommand(self, data: bytes) -> None:
        """The same for a telecommand, which has numbers of its own."""
        self._commanded = self._carried_out(data) or self._commanded

    def _carried_out(self, data: bytes) -> _Answer | None:
        request = unpack_request(data)
        if request is None:
            return None
        return request.number, self._handle.handle_command(request.event)[:MOST_CHARACTERS]

    def poll_status(self, now_ns: int) -> bytes | None:
        """Return the state as octets if it is due, or None."""
        if not self.watched:
            return None
        handle = self._handle
        operation = handle.operation
        reason = operation.prompt or operation.reason or operation.supervisor.reason
        test = operation.test
        (answered, refusal), (commanded, command_refusal) = self._answered, self._commanded
        robot = (handle.robot_waits, handle.robot_stopped)
        experiment = (operation.experiment, operation.partner)
        hand = (operation.state, handle.dead_man, handle.pressed, reason)
        present = (*hand, test, *experiment, answered, commanded, *robot)
        if present == self._told and now_ns < self._anew_ns:
            return None
        self._told, self._anew_ns = present, now_ns + _ANEW_NS
        facts, calibration = operation.facts, operation.calibration
        found = facts if calibration is None else calibration
        status = JoystickStatus(
            state=operation.state,
            reason=reason[:MOST_CHARACTERS],
            dead_man=handle.dead_man,
            force_limit_n=handle.force_limit_n,
            device=facts.name[:MOST_CHARACTERS],
            half_width_m=found.half_width_m,
            half_height_m=found.half_height_m,
            answered=answered,
            refusal=refusal,
            commanded=commanded,
            command_refusal=command_refusal,
            temperature_c=operation.reading.temperature_c,
            x_m=handle.x_m,
            y_m=handle.y_m,
            pressed=handle.pressed,
            robot_waits=handle.robot_waits,
            robot_stopped=handle.robot_stopped,
            axes=tuple(
                AxisStatus(
                    name=axis.facts.name,
                    place=axis.place_m / axis.lever_m,
                    half_range=axis.facts.half_range,
                    force=axis.cut_n * axis.lever_m,
                    force_limit=axis.facts.force_limit,
                )
                for axis in handle.more
            ),
            test=test.outcome.value,
            test_part=test.part.value,
            test_reason=test.reason[:MOST_CHARACTERS],
            test_number=test.number,
            test_figures={figure.name: figure.value for figure in test.figures},
            experiment=operation.experiment,
            partner=operation.partner,
        )
        return pack_status(status)
