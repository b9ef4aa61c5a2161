"""The functional checks of a joystick, and the core that runs them one after another.

Each check is an application: the device is calibrated first and supervised throughout. A halt or
an error ends the check, with its reason as the trouble.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.device import JoystickCapabilities, JoystickDevice
from telepresence.haptics.device.functional_checks import (
    BUTTONS,
    FRICTION,
    SPRING,
    WORKSPACE,
    buttons_check,
    friction_check,
    spring_check,
    workspace_check,
)
from telepresence.haptics.device.operation import JoystickOperation
from telepresence.haptics.device.script import IDLE, CheckResult, CheckScript, ScriptRun
from telepresence.haptics.device.states import JoystickState

#: Every check by its name, in the order in which they run.
CHECKS: Mapping[str, Callable[[JoystickCapabilities], CheckScript]] = MappingProxyType(
    {
        WORKSPACE: workspace_check,
        FRICTION: friction_check,
        SPRING: spring_check,
        BUTTONS: buttons_check,
    }
)

#: Longest wait for a device to become ready, which covers three attempts at the calibration.
_READY_NS = 40 * NS_PER_S


class CheckBench:
    """Calibrates `device` and runs the checks in `names`: call `handle_cycle` until `done`.

    results: one for each finished check.
    """

    def __init__(self, device: JoystickDevice, names: Sequence[str]) -> None:
        self.operation = JoystickOperation(device, hands_off=True)
        self.results: list[CheckResult] = []
        self._device = device
        self._names = list(names)
        self._run: ScriptRun[CheckResult] | None = None
        self._output = IDLE
        self._waiting_since_ns = 0

    @property
    def done(self) -> bool:
        """Whether every check has a result."""
        return not self._names

    @property
    def current(self) -> str:
        """The check that runs or comes next; "" when all are done."""
        return self._names[0] if self._names else ""

    @property
    def prompt(self) -> str:
        """What a person should do now; "" for nothing."""
        return self._output.prompt or self.operation.prompt

    def handle_cycle(self, now_ns: int, dt_ns: int) -> None:
        """Run one cycle, then advance the device by `dt_ns`."""
        operation = self.operation
        reading = operation.handle_reading(now_ns)
        self._output = IDLE
        if operation.state is JoystickState.APPLICATION and self._names:
            if self._run is None:
                self._run = ScriptRun(CHECKS[self._names[0]](operation.capabilities))
            self._output = self._run.handle_reading(reading, now_ns)
            if self._run.result is not None:
                self._finish(self._run.result, now_ns)
        elif self._names:
            self._handle_not_ready(now_ns)
        operation.handle_force(self._output.x_n, self._output.y_n, self._output.leds)
        self._device.advance(dt_ns)

    def _handle_not_ready(self, now_ns: int) -> None:
        operation = self.operation
        reason = operation.trouble or f"the device stays in the state {operation.state.words}"
        if self._run is not None:
            self._run.abort()
            self._finish(CheckResult(self._names[0], trouble=reason), now_ns)
        elif operation.given_up or now_ns - self._waiting_since_ns > _READY_NS:
            for name in list(self._names):
                self._finish(CheckResult(name, trouble=reason), now_ns)

    def _finish(self, result: CheckResult, now_ns: int) -> None:
        self.results.append(result)
        self._names.pop(0)
        self._run = None
        self._waiting_since_ns = now_ns
