"""A simulated joystick as a device: mechanics, motors, sensors, and possible faults.

The mechanics are those of `telepresence.haptics.joystick`, the hand that of
`telepresence.haptics.hand`. Without a hand, simulated fingers still answer the LEDs, as the check
of the buttons asks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi, sin
from types import MappingProxyType

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.haptics.axes import AxisReading, built_in_axes
from telepresence.haptics.device.device import KEEPS_FORCE_NS, JoystickCapabilities, JoystickReading
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import Hand
from telepresence.haptics.joystick import Joystick, JoystickModel

_MODEL = JoystickModel()

CAPABILITIES = JoystickCapabilities(
    name="simulated joystick",
    half_width_m=_MODEL.half_width_m,
    half_height_m=_MODEL.half_height_m,
    force_limit_n=_MODEL.force_limit_n,
    mass_kg=_MODEL.mass_kg,
    coulomb_n=_MODEL.coulomb_n,
    viscous_n_s_m=_MODEL.viscous_n_s_m,
    buttons=4,
    leds=4,
)

_NEVER_NS = 1 << 62


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """The faults of a simulated joystick; the defaults are a healthy one.

    stuck: axis 0 or 1 that does not move; -1 for none.
    friction: Coulomb friction over the nominal one.
    motor_gain: exerted over commanded force.
    dead_button: index of a button that does not react; -1 for none.
    heat_c: additional initial temperature of the motors (K).
    lost_ns: when the device is unplugged, after power-on.
    """

    stuck: int = -1
    friction: float = 1.0
    motor_gain: float = 1.0
    dead_button: int = -1
    heat_c: float = 0.0
    lost_ns: int = _NEVER_NS


#: Faults by their names in a SPEC, `sim:NAME`.
FAULTS: Mapping[str, Faults] = MappingProxyType(
    {
        "stuck-x": Faults(stuck=0),
        "stuck-y": Faults(stuck=1),
        "friction": Faults(friction=4.0),
        "weak": Faults(motor_gain=0.6),
        "button": Faults(dead_button=1),
        "hot": Faults(heat_c=80.0),
        "unplugged": Faults(lost_ns=8 * NS_PER_S),
    }
)


def open_simulated(
    fault: str = "", *, hand: Hand | None = None, axes: Sequence[str] = ()
) -> "SimulatedDevice":
    """Return the simulated joystick, broken by a fault of `FAULTS` if one is named; ConfigError."""
    if fault and fault not in FAULTS:
        raise ConfigError(f"joystick 'sim:{fault}': the faults are {', '.join(FAULTS)}")
    return SimulatedDevice(FAULTS.get(fault), hand=hand, axes=axes)


#: Time that a person takes to see an LED and press: simple reactions take 0.2 to 0.3 s
#: (R. D. Luce, "Response Times", 1986).
_REACTION_NS = 250 * NS_PER_MS
#: Time that a hand takes to close around the handle. Chosen.
_GRIP_NS = 400 * NS_PER_MS
#: Longest interval that one call simulates. After a stall, the rest is dropped.
_MAX_ADVANCE_NS = 50 * NS_PER_MS


class Fingers:
    """A person who presses the button whose LED is lit, and the dead-man button when all are lit.

    buttons, dead_man: what is pressed now.
    """

    def __init__(self, leds: int) -> None:
        self.buttons = 0
        self.dead_man = False
        self._all = (1 << leds) - 1
        self._seen = 0
        self._since_ns = 0
        self._now_ns = 0

    def handle_leds(self, mask: int) -> None:
        """The LEDs change to `mask`."""
        self._seen, self._since_ns = mask, self._now_ns

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass."""
        self._now_ns += dt_ns
        if self._now_ns - self._since_ns >= _REACTION_NS:
            self.dead_man = self._seen == self._all
            self.buttons = 0 if self.dead_man else self._seen


#: A hand on an axis behind x and y: spring (N/m), damper (N s/m), greatest pull (N); and what
#: brakes an axis that nobody holds (N s/m). Chosen.
_AXIS_HAND_N_M, _AXIS_HAND_N_S_M, _AXIS_PULL_N, _AXIS_BRAKE_N_S_M = 250.0, 15.0, 8.0, 40.0
#: The simulated hand moves them back and forth in this time (ns), to this share of their ranges.
_AXIS_PERIOD_NS, _AXIS_SHARE = 6 * NS_PER_S, 0.8

#: Position of the handle at power-on, where the encoders begin to count. Chosen.
START_M = (0.013, -0.021)


class Mechanics:
    """Handle, motors, encoders and LEDs of a simulated joystick; a device adds a hand and buttons.

    leds: mask of those that are lit.
    axes: the axes behind x and y.
    """

    capabilities: JoystickCapabilities

    def __init__(
        self,
        model: JoystickModel = _MODEL,
        *,
        start_m: tuple[float, float] = START_M,
        axes: Sequence[str] = (),
    ) -> None:
        self._axes = built_in_axes(axes, meets=False)
        self.capabilities = replace(
            self.capabilities, more=tuple(axis.capabilities for axis in self._axes)
        )
        self.joystick = Joystick(model, x_m=start_m[0], y_m=start_m[1])
        self.leds = 0
        self._zero_x, self._zero_y = start_m
        self._force_x_n = self._force_y_n = 0.0
        self._now_ns = self._written_ns = 0
        self._lost_ns = _NEVER_NS

    def set_zero(self, x_m: float, y_m: float) -> None:
        """Make the present position (x_m, y_m) the middle."""
        self._zero_x += x_m
        self._zero_y += y_m

    def write_force(self, x_n: float, y_n: float) -> None:
        """Set the motors' force (N, N); `Joystick` limits it."""
        self._force_x_n, self._force_y_n = x_n, y_n
        self._written_ns = self._now_ns

    def read_more(self) -> list[AxisReading]:
        """Return what the encoders of the axes behind x and y measure."""
        return [
            AxisReading(axis.position_m / axis.lever_m, axis.speed_m_s / axis.lever_m)
            for axis in self._axes
        ]

    def write_more_forces(self, forces: Sequence[float]) -> None:
        """Set the forces of the motors behind x and y (N; N m)."""
        for axis, force in zip(self._axes, forces, strict=True):
            axis.force_n = force / axis.lever_m

    def write_more_positions(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """No joystick takes places."""

    def write_leds(self, mask: int) -> None:
        """Light the LEDs in `mask`."""
        self.leds = mask

    def advance(self, dt_ns: int) -> None:
        """Simulate `dt_ns`, at most 50 ms."""
        self._now_ns += dt_ns
        if self._now_ns - self._written_ns > KEEPS_FORCE_NS:
            self._drop_forces()
        if 0 < dt_ns <= NS_PER_MS:
            self._step(dt_ns)
            return
        remaining_ns = min(dt_ns, _MAX_ADVANCE_NS)
        while remaining_ns > 0:
            self._step(min(remaining_ns, NS_PER_MS))
            remaining_ns -= NS_PER_MS

    def close(self) -> None:
        """Switch off force and LEDs; the device is gone."""
        self._drop_forces()
        self.write_leds(0)
        self._lost_ns = self._now_ns

    def _drop_forces(self) -> None:
        self._force_x_n = self._force_y_n = 0.0
        for axis in self._axes:
            axis.force_n = 0.0

    def _step(self, dt_ns: int) -> None:
        raise NotImplementedError

    def _step_axes(self, wanted: Sequence[float] | None, dt_ns: int) -> None:
        """Advance the axes behind x and y; a hand pulls them to these shares of their ranges.

        wanted: from -1 to 1; None: nobody holds them, and they brake.
        """
        for index, axis in enumerate(self._axes):
            if wanted is None:
                hand_n = -_AXIS_BRAKE_N_S_M * axis.speed_m_s
            else:
                stretch_m = wanted[index] * axis.half_m - axis.position_m
                pull_n = max(-_AXIS_PULL_N, min(_AXIS_PULL_N, _AXIS_HAND_N_M * stretch_m))
                hand_n = pull_n - _AXIS_HAND_N_S_M * axis.speed_m_s
            axis.step(axis.cut_n + hand_n, dt_ns)


class SimulatedDevice(Mechanics):
    """`Joystick` with sensors, buttons and LEDs, and optionally a hand.

    hand: holds the handle and presses the dead-man button while the joystick is in the application.
    Elsewhere its fingers answer the LEDs.
    start_m: position of the handle at power-on.
    stuck: an axis that does not move from now on; -1 for none.
    """

    capabilities = CAPABILITIES

    def __init__(
        self,
        faults: Faults | None = None,
        *,
        hand: Hand | None = None,
        start_m: tuple[float, float] = START_M,
        axes: Sequence[str] = (),
    ) -> None:
        self.hand = hand
        faults = faults or Faults()
        model = replace(_MODEL, coulomb_n=_MODEL.coulomb_n * faults.friction)
        super().__init__(model, start_m=start_m, axes=axes)
        self.joystick.temperature_c += faults.heat_c
        self.stuck = faults.stuck
        self._gain = faults.motor_gain
        self._live_buttons = ~(1 << faults.dead_button) if faults.dead_button >= 0 else -1
        self._lost_ns = faults.lost_ns
        self.fingers = Fingers(self.capabilities.leds)
        self._held_ns = -1
        self._told = False

    def handle_robot(self, heard: bool, waiting: bool) -> None:
        """Tell the hand that the robot is heard, or waits; an untold one presses all the time."""
        self._told = True
        if self.hand is not None and self._held_ns >= 0:
            self.hand.handle_robot(heard, waiting, self.joystick.x_m, self.joystick.y_m)

    def read(self) -> JoystickReading:
        """Return what the encoders, the buttons and the thermometer measure."""
        joystick, fingers = self.joystick, self.fingers
        hand, buttons = self.hand, fingers.buttons
        held = fingers.dead_man
        if hand is not None and self._held_ns >= 0:
            buttons |= hand.buttons
            # The button comes last, so a joystick that has just started sees it released.
            held = hand.dead_man and self._held_ns >= _GRIP_NS
        reading = (
            joystick.x_m - self._zero_x,
            joystick.y_m - self._zero_y,
            joystick.vx_m_s,
            joystick.vy_m_s,
            buttons & self._live_buttons,
            held,
            joystick.temperature_c,
            self._now_ns < self._lost_ns,
            "",
            False,
            False,
        )
        # Skips `JoystickReading.__new__`, which is one more Python call a thousand times a second.
        return tuple.__new__(JoystickReading, reading)

    def write_force(self, x_n: float, y_n: float) -> None:
        """Set the motors' force (N, N), as strong as they are; `Joystick` limits it."""
        gain = self._gain
        super().write_force(gain * x_n, gain * y_n)

    def write_leds(self, mask: int) -> None:
        """Light the LEDs in `mask`; the simulated fingers see them."""
        super().write_leds(mask)
        self.fingers.handle_leds(mask)

    def show_state(self, state: JoystickState) -> None:
        """Let the hand take the handle in the application, and release it elsewhere."""
        if self.hand is not None:
            self._held_ns = 0 if state is JoystickState.APPLICATION else -1
            if self._told:
                self.hand.let_go(self.joystick.x_m, self.joystick.y_m)
            self.fingers = Fingers(self.capabilities.leds)

    def _step(self, dt_ns: int) -> None:
        joystick, hand = self.joystick, self.hand
        x, y, vx, vy = joystick.x_m, joystick.y_m, joystick.vx_m_s, joystick.vy_m_s
        hand_x = hand_y = hand_kg = 0.0
        if self._held_ns < 0:
            self.fingers.advance(dt_ns)
        elif hand is not None:
            hand_x, hand_y = hand.force(x, y, vx, vy, dt_ns)
            hand_kg = hand.mass_kg
            if self._held_ns < _GRIP_NS:
                # The fingers close gradually, so the force does not jump.
                self._held_ns += dt_ns
                grip = self._held_ns / _GRIP_NS
                hand_x *= grip
                hand_y *= grip
        joystick.push(self._force_x_n, self._force_y_n, hand_x, hand_y, hand_kg, dt_ns)
        if self.stuck == 0:
            joystick.x_m, joystick.vx_m_s = x, 0.0
        elif self.stuck == 1:
            joystick.y_m, joystick.vy_m_s = y, 0.0
        if self._axes:
            wanted = None
            if hand is not None and self._held_ns >= _GRIP_NS:
                share = _AXIS_SHARE * sin(2.0 * pi * (self._now_ns / _AXIS_PERIOD_NS))
                wanted = [share] * len(self._axes)
            self._step_axes(wanted, dt_ns)
