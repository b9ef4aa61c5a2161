"""The controllers of the axes behind x and y, one pair and one port for each.

They are those of x and y, with one coordinate. Rotations count as paths at their lever (`axes`).
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.axes import AxisValue, MoreAxis
from telepresence.haptics.haptic_metrics import PortMetrics
from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.passivity import PortController
from telepresence.haptics.robot_controller import RobotController, RobotControllerModel
from telepresence.haptics.sample import Command, Feedback, along

_CYCLE_S = NS_PER_MS / NS_PER_S
#: What a handle deflected fully tells of an axis in rate mode (m), and below which share of it the
#: axis rests; before the first rest after a press it does not move.
RATE_FULL_M, _NEUTRAL = 0.1, 0.05


class _Axes:
    """What both sides have in common: the axes behind x and y, and a controller for each."""

    axes: Sequence[MoreAxis]
    controllers: Sequence[PortController]
    #: The attribute of an axis that a row has as its force: of the
    #: surroundings on a robot, of the motor on a handle.
    _force: str
    #: By controller: what `acted` was at the last sample.
    _acted: list[int]

    @property
    def columns(self) -> list[str]:
        """Of each axis its name and its unit, as `z_m`."""
        facts = [axis.capabilities for axis in self.axes]
        return [f"{one.name}_{one.unit}" for one in facts]

    def row(self) -> list[float]:
        """Return, of each axis, place (m; rad), force (N; N m) and credit (µJ)."""
        values: list[float] = []
        for axis, controller in zip(self.axes, self.controllers, strict=True):
            lever_m = axis.lever_m
            force = getattr(axis, self._force) * lever_m
            values += axis.position_m / lever_m, force, controller.credit_uj
        return values

    def values(self) -> tuple[AxisValue, ...]:
        """Return what the next sample says of each axis."""
        acted = self._acted
        self._acted = [controller.acted for controller in self.controllers]
        return tuple(
            (self._told(axis), controller.port.granted_uj, controller.acted != before)
            for axis, controller, before in zip(self.axes, self.controllers, acted, strict=True)
        )

    def _told(self, axis: MoreAxis) -> float:
        """What a sample tells of an axis."""
        raise NotImplementedError

    def report(self) -> dict[str, PortMetrics]:
        """Return the energies of each axis' port, by its name; in rate mode none pass it."""
        return {
            axis.capabilities.name: controller.report()
            for axis, controller in zip(self.axes, self.controllers, strict=True)
            if not axis.rate
        }


class RobotAxes(_Axes):
    """At the robot: each axis follows the hand's by a spring and a damper.

    With a scale, the force that is told has it too, so that the power is the same at both ends. In
    rate mode nothing is told: the loop is open, and its port only observes.
    """

    _force = "push_n"

    def __init__(
        self, axes: Sequence[MoreAxis], model: RobotControllerModel, *, passive: bool = True
    ) -> None:
        self.axes, grips = axes, not passive
        self.controllers: Sequence[RobotController] = [
            RobotController(
                replace(
                    model,
                    force_limit_n=min(model.force_limit_n, axis.force_limit_n),
                    speed_m_s=axis.most_m_s,
                    half_width_m=axis.half_m,
                    # Where nobody feels it, a gripper keeps its grip when the hand lets go.
                    relax_s=inf if grips and axis.capabilities.name == "gripper" else model.relax_s,
                ),
                x_m=axis.position_m,
                passive=passive and not axis.rate,
            )
            for axis in axes
        ]
        self._acted = [0] * len(axes)
        self._offsets = [0.0] * len(axes)
        #: In rate mode: the handle has been in its middle since the press.
        self._neutral = [False] * len(axes)
        self._presses = 0

    def step(self, command: Command | None, dt_ns: int, *, presses: int, speed: float) -> None:
        """Set the force of each axis.

        command: as admitted for x and y. presses: number of the newest press, at which the offset
        between hand and axis is taken. speed: share of an axis's own speed, 0 to 1.
        """
        pressed, self._presses = presses != self._presses, presses
        for index, (axis, controller) in enumerate(zip(self.axes, self.controllers, strict=True)):
            own = None
            if command is not None:
                position_m, energy_uj, acted = command[-1][index]
                if axis.rate:
                    position_m = self._led(index, axis, controller, position_m, pressed=pressed)
                else:
                    position_m *= axis.scale
                    if pressed:
                        self._offsets[index] = controller.reference_x_m - position_m
                    position_m += self._offsets[index]
                own = along(command, position_m, energy_uj, acted)
            controller.speed_m_s = speed * axis.most_m_s
            axis.force_n, _ = controller.step(
                own, axis.position_m, 0.0, axis.speed_m_s, 0.0, dt_ns, touching=axis.contact
            )

    def _led(
        self,
        index: int,
        axis: MoreAxis,
        controller: RobotController,
        told_m: float,
        *,
        pressed: bool,
    ) -> float:
        """Return the place that leads the reference with the speed that a handle asks for."""
        share = max(-1.0, min(1.0, told_m / RATE_FULL_M))
        rests = abs(share) < _NEUTRAL
        self._neutral[index] = rests or (self._neutral[index] and not pressed)
        speed_m_s = 0.0
        if self._neutral[index] and not rests:
            speed_m_s = share * axis.scale * controller.speed_m_s
        # Before an obstacle the reference does not run away.
        model = controller.model
        lead_m = model.force_limit_n / model.stiffness_n_m
        off_m = controller.reference_x_m - axis.position_m
        base_m = axis.position_m + max(-lead_m, min(lead_m, off_m))
        return base_m + speed_m_s * (model.follow_s + _CYCLE_S)

    def _told(self, axis: MoreAxis) -> float:
        return 0.0 if axis.rate else axis.push_n * axis.scale

    def release(self) -> None:
        """The robot follows no hand in this cycle."""
        for axis, controller in zip(self.axes, self.controllers, strict=True):
            controller.release(axis.position_m, 0.0)
            axis.force_n = 0.0


class JoystickAxes(_Axes):
    """At the joystick: each axis of the handle feels the robot's force."""

    _force = "force_n"

    def __init__(
        self,
        axes: Sequence[MoreAxis],
        model: JoystickControllerModel | None,
        *,
        passive: bool = True,
    ) -> None:
        self.axes = axes
        self.controllers: Sequence[JoystickController] = [
            JoystickController(model, passive=passive) for _ in axes
        ]
        self._acted = [0] * len(axes)

    def step(self, feedback: Feedback | None, limit_n: float, last_ns: int) -> None:
        """Set the force of each axis, `last_ns` after the previous step.

        limit_n: the force that the handle may exert along x and y now.
        """
        for index, (axis, controller) in enumerate(zip(self.axes, self.controllers, strict=True)):
            own = None
            if feedback is not None:
                own = along(feedback, *feedback[-1][index])
            controller.limit_n = min(limit_n, axis.force_limit_n)
            if axis.rate:
                continue
            axis.force_n, _ = controller.step(own, axis.position_m, 0.0, last_ns)

    def _told(self, axis: MoreAxis) -> float:
        return axis.position_m / axis.half_m * RATE_FULL_M if axis.rate else axis.position_m
