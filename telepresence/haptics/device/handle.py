"""The joystick in operation as the handle that the bilateral controller works with."""

from collections import deque
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.operation import Operation
from telepresence.haptics.device.states import State
from telepresence.haptics.device.supervision import Limits
from telepresence.haptics.sample import Feedback

#: Only here is a reading a place: before, the encoders' zero is anywhere.
_PLACED = (State.CALIBRATED, State.APPLICATION, State.HALTED)
#: A silence is counted in seconds: that the robot is heard is told no more often than this.
_HEARD_NS = 20 * NS_PER_MS


class OperatedHandle:
    """`telepresence.haptics.bilateral.Handle` on a `JoystickDevice`, through its `Operation`.

    x_m, y_m: the calibrated place, at rest as long as there is none. force_limit_n: 0 outside the
    application and while the dead-man button is let go. dead_man, buttons, state: what the samples
    say. Its time is what `step` is told, so that it runs on virtual time as well.
    """

    def __init__(self, device: JoystickDevice, *, limits: Limits | None = None) -> None:
        self.device = device
        self.operation = Operation(device, limits=limits)
        self.x_m = self.y_m = 0.0
        self.force_limit_n = 0.0
        self.dead_man = False
        self.buttons = 0
        self.state = int(State.INIT)
        self._known = State.INIT
        self._placed = False
        self._leds = 0
        self._heard_ns = 0
        self._now_ns = 0
        self._log: deque[dict[str, Any]] = deque(maxlen=20)

    @property
    def now_ns(self) -> int:
        """How much time its steps have taken so far."""
        return self._now_ns

    def handle_feedback(self, feedback: Feedback) -> None:
        """A fresh sample of the robot: it is heard, and its LED is lit on the joystick too."""
        now_ns = self._now_ns
        if now_ns >= self._heard_ns:
            self._heard_ns = now_ns + _HEARD_NS
            self.operation.handle_heard(now_ns)
        lit = feedback[5]
        self._leds = 0 if lit is None else 1 << lit

    def report(self) -> dict[str, Any]:
        """`Operation.report`, and `log`: the last 20 transitions, `s` after the handle began."""
        while (transition := self.operation.next_event()) is not None:
            self._log.append(
                {
                    "s": round(transition.now_ns / NS_PER_S, 3),
                    "event": transition.event.value,
                    "state": transition.after.words,
                    "reason": transition.reason,
                }
            )
        return {**self.operation.report(), "log": list(self._log)}

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        """Exert this force (N, N), and be where the handle is `dt_ns` later."""
        operation = self.operation
        operation.handle_force(fx_n, fy_n, self._leds)
        self.device.advance(dt_ns)
        self._now_ns = now_ns = self._now_ns + dt_ns
        reading = operation.handle_reading(now_ns)
        state = operation.machine.state
        if state is not self._known:
            self._known, self.state, self._placed = state, int(state), state in _PLACED
        if self._placed:
            self.x_m, self.y_m = reading[0], reading[1]
        self.buttons, self.dead_man = reading[4], reading[5]
        self.force_limit_n = operation.force_limit_n
