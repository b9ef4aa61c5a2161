"""Adapts a joystick in operation to the `Handle` that the bilateral controller uses."""

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from typing import cast

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.returned import fault_of
from telepresence.haptics.axes import MoreAxes, MoreAxis, set_up_axes
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.guest import HandleGuest
from telepresence.haptics.device.operation import UNFELT_FORCE_LIMIT_N, JoystickOperation
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.haptics.device.supervision import Limits, NoiseMeter
from telepresence.haptics.haptic_metrics import JoystickMetrics, LoggedTransition
from telepresence.haptics.sample import Drive, Feedback

#: Only in these states is a reading a calibrated position.
_PLACED = (JoystickState.CALIBRATED, JoystickState.APPLICATION, JoystickState.HALTED)
#: Shortest interval between reports that the robot was heard; silence is counted in seconds.
_HEARD_NS = 20 * NS_PER_MS
#: What a robot told that has been silent for longer may be so no more.
_TRUSTED_NS = 500 * NS_PER_MS


class OperatedHandle:
    """`telepresence.haptics.bilateral.Handle` on a `JoystickDevice`, by its `JoystickOperation`.

    x_m, y_m: calibrated position; it rests while there is no calibration.
    force_limit_n: 0 outside the application and while the dead-man button is released.
    stop, blind: the caller sets both. pressed: how often a button went down.
    stop_asked: its button for the emergency stop was pressed; the caller resets it.
    robot_waits, robot_stopped, drive: what the robot's newest sample says. frozen: it says that a
    part of the operator's picture is.
    command_age_ms: of the commands that the robot gets; the caller sets it, None if unknown.
    guest: a policy at the handle, which the caller sets; None: there can be none.
    presses_n: how hard the robot presses; the caller sets it.
    more: the axes behind x and y; their middle is where the device reads 0. axes: their names, with
    what the setup says of them. plane: which of x and y there are; the others stay at 0.

    Its time is the sum of what `step` was told, so it runs on virtual time too.
    """

    def __init__(
        self,
        device: JoystickDevice,
        *,
        limits: Limits | None = None,
        paused: str = "",
        axes: Sequence[str] = (),
        plane: Sequence[str] = ("x", "y"),
    ) -> None:
        self.device = device
        self.operation = JoystickOperation(device, limits=limits, paused=paused)
        self._simulated = device if isinstance(device, SimulatedDevice) else None
        self.x_m = self.y_m = 0.0
        self.force_limit_n = 0.0
        self.dead_man = self.stop = self.blind = self.stop_asked = False
        self._hands_over = False
        self.guest: HandleGuest | None = None
        self.buttons = self.pressed = 0
        self.robot_waits = self.robot_stopped = False
        self.drive: Drive = ""
        self.frozen = False
        self.command_age_ms: int | None = None
        self.presses_n = 0.0
        self.state = int(JoystickState.INIT)
        self.more: Sequence[MoreAxis] = [MoreAxis(each) for each in device.capabilities.more]
        set_up_axes(self.more, axes, limits=False)
        #: None: both.
        self._plane = None if {"x", "y"} <= {*plane} else ("x" in plane, "y" in plane)
        self._axes: MoreAxes | None = cast(MoreAxes, device) if self.more else None
        self._known = JoystickState.INIT
        #: Without motors nobody feels the noise.
        self._noise = NoiseMeter() if device.capabilities.has_force else None
        self._placed = False
        self._leds = 0
        self._heard_ns = 0
        self._now_ns = 0
        self._log: deque[LoggedTransition] = deque(maxlen=20)

    @property
    def now_ns(self) -> int:
        """The sum of all steps so far."""
        return self._now_ns

    def handle_feedback(self, feedback: Feedback | None) -> None:
        """Take a fresh sample, or None: the robot was heard, or not. Light the same LED here."""
        if self._simulated is not None:
            self._simulated.handle_robot(feedback is not None, feedback is not None and feedback[8])
        now_ns = self._now_ns
        if feedback is None:
            if now_ns >= self._heard_ns + _TRUSTED_NS:
                self.robot_stopped, self.drive, self.frozen = False, "", False
            return
        if now_ns >= self._heard_ns:
            self._heard_ns = now_ns + _HEARD_NS
            self.operation.handle_heard(now_ns)
        lit, self.robot_waits, self.robot_stopped = feedback[5], feedback[8], feedback[9]
        self.frozen = feedback[10]
        self.drive = feedback.drive if feedback[7] else "hand"
        self._leds = 0 if lit is None else 1 << lit

    def handle_command(self, event: JoystickEvent, *by: str) -> str:
        """Carry out a person's command, as `Operation.handle_command` does."""
        refusal = self.operation.handle_command(event, self._now_ns, *by)
        self.force_limit_n = self.operation.force_limit_n
        return refusal

    def handle_exercise(self, lasts_ns: int) -> None:
        """Have a fault for so long: a trainer's exercise. 0 or less ends it."""
        self.operation.handle_exercise(self._now_ns + lasts_ns)

    def report(self) -> JoystickMetrics:
        """Return `Operation.report`, and the last 20 transitions."""
        while (transition := self.operation.next_event()) is not None:
            self._log.append(
                LoggedTransition(
                    s=round(transition.now_ns / NS_PER_S, 3),
                    event=transition.event.value,
                    state=transition.after.words,
                    reason=transition.reason,
                )
            )
        return JoystickMetrics(**asdict(self.operation.report()), log=list(self._log))

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        """Apply this force (N, N) for `dt_ns`, then read the handle."""
        operation = self.operation
        operation.handle_force(fx_n, fy_n, self._leds)
        axes = self._axes
        if axes is not None:
            free = operation.machine.state is JoystickState.APPLICATION
            axes.write_more_forces([axis.cut_n * axis.lever_m * free for axis in self.more])
        self.device.advance(dt_ns)
        self._now_ns = now_ns = self._now_ns + dt_ns
        reading = operation.handle_reading(now_ns)
        if axes is not None:
            try:
                for axis, more in zip(self.more, axes.read_more(), strict=True):
                    if trouble := axis.take(more):
                        operation.handle_trouble(trouble, now_ns)
            except Exception as error:
                operation.handle_trouble(fault_of("read_more()", error), now_ns)
        state = operation.machine.state
        noise = self._noise if state is JoystickState.APPLICATION else None
        if noise is not None and (trouble := noise.handle_place(reading[0], reading[1])):
            operation.handle_trouble(trouble, now_ns)
        if state is not self._known:
            self._known, self.state, self._placed = state, int(state), state in _PLACED
        if self._placed:
            self.x_m, self.y_m = reading[0], reading[1]
            if self._plane is not None:
                self.x_m *= self._plane[0]
                self.y_m *= self._plane[1]
        if reading[4] & ~self.buttons:
            self.pressed += 1
        if reading[9]:
            self.stop_asked = True
        if reading[10] is not self._hands_over:
            self._hands_over = reading[10]
            if reading[10]:
                person = operation.driver != ""
                operation.handle_command(
                    JoystickEvent.PERSON if person else JoystickEvent.POLICY, now_ns
                )
        # The button that a test asks for does not count for the robot or the panel.
        self.buttons, self.dead_man = reading[4], reading[5] and not operation.testing
        self.force_limit_n = operation.force_limit_n
        if self.guest is not None:
            self._let_guest(self.guest, dt_ns)

    @property
    def pressed_by_person(self) -> bool:
        """Whether a person presses the dead-man button, where a policy could, too."""
        operation = self.operation
        return self.guest is not None and operation.held and not operation.testing

    def _let_guest(self, guest: HandleGuest, dt_ns: int) -> None:
        """Put a policy in the place of the person, if it drives."""
        application = self.operation.machine.state is JoystickState.APPLICATION
        guest.step(dt_ns, person=self.pressed_by_person, allowed=application)
        if guest.drives or guest.holds:
            self.dead_man = guest.drives
            self.force_limit_n = UNFELT_FORCE_LIMIT_N * guest.force_share
        if guest.drives:
            in_x, in_y = self._plane or (True, True)
            self.x_m, self.y_m = guest.x_m * in_x, guest.y_m * in_y
