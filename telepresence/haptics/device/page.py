"""The simulated joystick in the hand of a person at a browser page.

The robot's force displaces the handle. The page only says where its person wants the handle to be.
Muscles, a spring and a damper as in `telepresence.haptics.hand`, pull it there while the dead-man
button is held and the inputs are fresh. Otherwise the handle is braked and stays where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.simulated import CAPABILITIES as SIMULATED_CAPABILITIES
from telepresence.haptics.device.simulated import START_M, Mechanics
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import HandModel

CAPABILITIES = replace(SIMULATED_CAPABILITIES, name="browser page")

#: The soft grip of `telepresence.haptics.hand`, limited to what the motors can hold without end:
#: 8 N heat them by 32 K, which is below the supervision's warning.
GRIP = HandModel(stiffness_n_m=250.0, damping_n_s_m=15.0, mass_kg=0.2, push_n=8.0)

#: Of a hand whose page shows no picture of the robot.
NO_PICTURE = -1

_SEQUENCES = 1 << 32
_BUTTONS = (1 << CAPABILITIES.buttons) - 1


class PageInput(NamedTuple):
    """What a page says of the hand.

    dead_man: the person holds the dead-man key, button or trigger.
    x, y: wanted place of the handle, from -1 to 1 of the half workspace; y points up.
    buttons: one bit for each pressed button, 0x1 for the first.
    sequence: counts the inputs of a page, modulo 2^32.
    received_ns: when the page's process received it, on the session's clock.
    picture_ns: when the picture was captured that the page has painted last; 0 if it has painted
    none, `NO_PICTURE` if it shows none.
    more: wanted places of the axes behind x and y, from -1 to 1 of their half ranges.
    keeps_ns: for how long it holds the button at that place; 0: as long as a page's input.
    """

    dead_man: bool
    x: float
    y: float
    buttons: int = 0
    sequence: int = 0
    received_ns: int = 0
    picture_ns: int = NO_PICTURE
    more: tuple[float, ...] = ()
    keeps_ns: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class PageHandModel:
    """Parameters of the hand that a page drives; chosen, but for the muscles (`HandModel`).

    muscles: between the handle and the wanted place.
    fresh_ns: an older input releases the hand.
    resume_ns: inputs that were missing for no longer hold the button anew; after more, the person
    must let go and press.
    follow_s: time constant of the critically damped filter that smooths the pointer's steps. Two
    of it are longer than the interval between two events at 60 Hz.
    speed_m_s: greatest speed of the wanted place; about a quick movement of a wrist.
    brake_n_s_m: damper that stops a released handle.
    """

    muscles: HandModel = GRIP
    fresh_ns: int = 100 * NS_PER_MS
    resume_ns: int = 200 * NS_PER_MS
    follow_s: float = 0.01
    speed_m_s: float = 1.0
    brake_n_s_m: float = 40.0


class PageDevice(Mechanics):
    """A `JoystickDevice` that `handle_input` moves. Its time is the sum of what `advance` was told.

    held: the hand holds the handle.
    ignored: inputs that were too old, repeated, not finite or out of range.

    The hand takes the handle only in the application. While the joystick calibrates or tests itself
    the handle is free; otherwise it is braked where it is. The dead-man button is the person's
    alone: a change of the state neither releases nor presses it.
    """

    # Who steers by mouse, finger or keys has the dead-man button alone.
    capabilities = replace(CAPABILITIES, buttons=0)

    def __init__(
        self,
        *,
        start_m: tuple[float, float] = START_M,
        axes: Sequence[str] = (),
    ) -> None:
        super().__init__(start_m=start_m, axes=axes)
        #: Where the page wants the axes behind x and y, in shares of their half ranges.
        self._wanted = [0.0] * len(axes)
        #: From what the page says to that.
        self._shifts = [0.0] * len(axes)
        self.model = PageHandModel()
        self.held = False
        self.ignored = 0
        self._application = self._braked = False
        self._all_leds = (1 << self.capabilities.leds) - 1
        self._buttons = 0
        self._newest: PageInput | None = None
        self._fresh_until_ns = 0
        self._pressed = False
        #: Since when inputs were missing though the button was pressed; its release may be, too.
        self._silent_ns: int | None = None
        #: From the place that the page wants to the one that the hand moves to.
        self._shift_x = self._shift_y = 0.0
        #: Where the hand moves to; then the filtered place, and its velocity.
        self._to_x = self._to_y = 0.0
        self._x = self._y = self._vx = self._vy = 0.0

    def handle_input(self, hand: PageInput, age_ns: int = 0) -> None:
        """Take an input that is `age_ns` old.

        One without the dead-man button always releases. Any other must be fresh, newer than the one
        before, finite and in range.
        """
        if not hand.dead_man:
            self.held = self._pressed = False
            self._silent_ns = None
        fresh_ns = (hand.keeps_ns or self.model.fresh_ns) - max(age_ns, 0)
        if not (
            fresh_ns > 0
            and -1.0 <= hand.x <= 1.0
            and -1.0 <= hand.y <= 1.0
            and all(-1.0 <= share <= 1.0 for share in hand.more)
            and self._is_newer(hand)
        ):
            self.ignored += 1
            return
        self._newest = hand
        self._fresh_until_ns = self._now_ns + fresh_ns
        self._buttons = hand.buttons & _BUTTONS
        silent_ns, now_ns = self._silent_ns, self._now_ns
        if hand.dead_man and (silent_ns is None or now_ns - silent_ns <= self.model.resume_ns):
            self._pressed, self._silent_ns = True, None
        if not (self._pressed and self._application):
            return
        capabilities = self.capabilities
        wide, high = capabilities.half_width_m, capabilities.half_height_m
        if not self.held:
            self._take(hand.x * wide, hand.y * high)
            self._take_axes(hand.more)
        for index, (share, shift) in enumerate(zip(hand.more, self._shifts, strict=False)):
            self._wanted[index] = max(-1.0, min(1.0, share + shift))
        self._to_x = max(-wide, min(wide, hand.x * wide + self._shift_x))
        self._to_y = max(-high, min(high, hand.y * high + self._shift_y))

    def read(self) -> JoystickReading:
        """Return what the encoders, the page's buttons and the thermometer measure."""
        joystick = self.joystick
        reading = (
            joystick.x_m - self._zero_x,
            joystick.y_m - self._zero_y,
            joystick.vx_m_s,
            joystick.vy_m_s,
            self._buttons,
            self._pressed,
            joystick.temperature_c,
            self._now_ns < self._lost_ns,
            "",
            False,
            False,
        )
        return tuple.__new__(JoystickReading, reading)

    @property
    def picture_ns(self) -> int:
        """As the newest input has it while the button is held: a page is silent afterwards."""
        return self._newest.picture_ns if self._newest and self._pressed else NO_PICTURE

    @property
    def _asked(self) -> bool:
        """All LEDs ask for the dead-man button, as the functional test does, and it is pressed."""
        return self.leds == self._all_leds and self._pressed

    def show_state(self, state: JoystickState) -> None:
        """Let the hand take the handle in the application only."""
        self.held = False
        self._application = state is JoystickState.APPLICATION
        self._braked = state not in (JoystickState.INIT, JoystickState.STANDBY)

    def _is_newer(self, hand: PageInput) -> bool:
        newest = self._newest
        if newest is None:
            return True
        if 0 < (hand.sequence - newest.sequence) % _SEQUENCES < _SEQUENCES // 2:
            return hand.received_ns >= newest.received_ns
        # Another page, or another start of its process, counts anew; not while a hand is fresh.
        return self._now_ns >= self._fresh_until_ns and hand.received_ns > newest.received_ns

    def _take(self, x_m: float, y_m: float) -> None:
        """Hold the handle where it is; the page's present place (x_m, y_m) means that place."""
        joystick = self.joystick
        self.held = True
        self._x, self._y = joystick.x_m - self._zero_x, joystick.y_m - self._zero_y
        self._vx = self._vy = 0.0
        self._shift_x, self._shift_y = self._x - x_m, self._y - y_m

    def _take_axes(self, shares: Sequence[float]) -> None:
        """Hold the axes where they are; these shares mean those places."""
        self._wanted = [axis.position_m / axis.half_m for axis in self._axes]
        self._shifts = [
            position - share for position, share in zip(self._wanted, shares, strict=False)
        ]

    def _step(self, dt_ns: int) -> None:
        joystick, model = self.joystick, self.model
        if self._now_ns >= self._fresh_until_ns:
            self._buttons = 0
            if self._pressed:
                self._silent_ns = self._now_ns
            self.held = self._pressed = False
        if self._axes:
            self._step_axes(self._wanted if self.held else None, dt_ns)
        if not self.held:
            brake = model.brake_n_s_m if self._braked and not self._asked else 0.0
            brake_x, brake_y = -brake * joystick.vx_m_s, -brake * joystick.vy_m_s
            joystick.push(self._force_x_n, self._force_y_n, brake_x, brake_y, 0.0, dt_ns)
            return
        dt_s, per_s, most = dt_ns / NS_PER_S, 1.0 / model.follow_s, model.speed_m_s
        vx = self._vx + ((self._to_x - self._x) * per_s - 2.0 * self._vx) * per_s * dt_s
        vy = self._vy + ((self._to_y - self._y) * per_s - 2.0 * self._vy) * per_s * dt_s
        if (speed := hypot(vx, vy)) > most:
            vx *= most / speed
            vy *= most / speed
        self._vx, self._vy = vx, vy
        self._x += vx * dt_s
        self._y += vy * dt_s
        muscles = model.muscles
        stiffness, damping = muscles.stiffness_n_m, muscles.damping_n_s_m
        pull_x = stiffness * (self._x + self._zero_x - joystick.x_m)
        pull_y = stiffness * (self._y + self._zero_y - joystick.y_m)
        if (pull := hypot(pull_x, pull_y)) > muscles.push_n:
            pull_x *= muscles.push_n / pull
            pull_y *= muscles.push_n / pull
        joystick.push(
            self._force_x_n,
            self._force_y_n,
            pull_x + damping * (vx - joystick.vx_m_s),
            pull_y + damping * (vy - joystick.vy_m_s),
            muscles.mass_kg,
            dt_ns,
        )


class Ros2Device(PageDevice):
    """The same, in the hand of a ROS 2 node in the place of a page."""

    capabilities = replace(CAPABILITIES, name="ROS 2 node")
