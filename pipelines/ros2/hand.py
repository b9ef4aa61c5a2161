"""A ROS 2 node in the place of a page that moves the handle: `/joy` and `/cmd_vel`. A core.

The dead-man button is one of `/joy`. While it is held, the axes of `/joy` say where the handle is
to be, and `/cmd_vel` moves that place. The device is `Ros2Device`: it takes the handle where it is,
limits its speed, lets go 100 ms after the newest `/joy`, and then wants a new press.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.haptics.axes import built_in_axis
from telepresence.haptics.device.page import CAPABILITIES, PageHandModel, PageInput

#: The left shoulder, as `joy_node` of ROS 2 numbers the buttons of the usual controllers.
DEAD_MAN_BUTTON: Final = 4
#: A hand that was not heard for this long is gone, and another node may take its place.
_FRESH_NS = PageHandModel().fresh_ns
#: Nodes that steer send ten times a second or more often.
_VELOCITY_FRESH_NS = 200 * NS_PER_MS
#: A motion is counted on for no longer than this, however late a call is.
_MOST_STEP_NS = 50 * NS_PER_MS


class JoyMessage(NamedTuple):
    """What counts of a `sensor_msgs/Joy`. Axes are from -1 to 1: the first to the left, then up."""

    axes: tuple[float, ...]
    buttons: tuple[bool, ...]


#: What counts of a `geometry_msgs/TwistStamped`: m/s and rad/s, by the name of the axis.
Velocity = Mapping[str, float]


class _Speaker:
    """The node that is heard: the first one, until it is silent."""

    def __init__(self, fresh_ns: int) -> None:
        self._fresh_ns = fresh_ns
        self._gid = b""
        self.heard_ns: int | None = None

    def fresh(self, now_ns: int) -> bool:
        return self.heard_ns is not None and now_ns - self.heard_ns < self._fresh_ns

    def hears(self, gid: bytes, now_ns: int) -> bool:
        """Whether a message of this publisher counts."""
        if self.fresh(now_ns) and gid != self._gid:
            return False
        self._gid, self.heard_ns = gid, now_ns
        return True


class Ros2Hand:
    """What nodes say, as inputs for the joystick. Call `poll_transmit` every few milliseconds.

    more: the axes behind x and y. taken, refused: messages that counted, and those of a node while
    another one is heard.
    """

    def __init__(self, more: Sequence[str] = ()) -> None:
        self._names = ("x", "y", *more)
        self._halves = (
            CAPABILITIES.half_width_m,
            CAPABILITIES.half_height_m,
            *(built_in_axis(name).half_range for name in more),
        )
        self.taken = self.refused = 0
        self._hand = _Speaker(_FRESH_NS)
        self._driver = _Speaker(_VELOCITY_FRESH_NS)
        self._positions = [0.0] * len(self._halves)
        self._buttons = 0
        self._held = False
        #: The button was released since the hand was heard.
        self._released = False
        self._velocity: Velocity = {}
        #: How far `/cmd_vel` has moved the place, in shares of the half range.
        self._moved = [0.0] * len(self._halves)
        self._polled_ns: int | None = None
        self._told_ns: int | None = None
        self._sequence = 0

    def handle_joy(self, joy: JoyMessage, gid: bytes, now_ns: int) -> None:
        """Take a message of `/joy`; ProtocolError for values that cannot be."""
        if not all(-1.0 <= axis <= 1.0 for axis in joy.axes) or len(joy.axes) < 2:
            raise ProtocolError(f"/joy has the axes {joy.axes}: two or more from -1 to 1")
        known = self._hand.fresh(now_ns)
        if not self._hand.hears(gid, now_ns):
            self.refused += 1
            return
        self.taken += 1
        pressed = len(joy.buttons) > DEAD_MAN_BUTTON and joy.buttons[DEAD_MAN_BUTTON]
        # The button may have been held since before: motion needs a new press.
        self._released = (self._released and known) or not pressed
        self._held = pressed and self._released
        self._buttons = sum(1 << at for at, on in enumerate(joy.buttons[:DEAD_MAN_BUTTON]) if on)
        positions = (-joy.axes[0], *joy.axes[1 : len(self._halves)])
        self._positions = [*positions, *[0.0] * (len(self._halves) - len(positions))]

    def handle_velocity(self, velocity: Velocity, gid: bytes, now_ns: int) -> None:
        """Take a message of `/cmd_vel`; ProtocolError for values that are not finite."""
        if not all(map(isfinite, velocity.values())):
            raise ProtocolError("/cmd_vel has a velocity that is not finite")
        if not self._driver.hears(gid, now_ns):
            self.refused += 1
            return
        self.taken += 1
        self._velocity = velocity

    def poll_transmit(self, now_ns: int) -> PageInput | None:
        since_ns, self._polled_ns = self._polled_ns, now_ns
        heard_ns = self._hand.heard_ns
        if heard_ns is None or not self._hand.fresh(now_ns):
            self._held = self._released = False
        driven = self._driver.fresh(now_ns)
        if not self._held:
            self._moved = [0.0] * len(self._halves)
        elif driven and since_ns is not None:
            self._move(min(now_ns - since_ns, _MOST_STEP_NS))
        if heard_ns is None or not (heard_ns != self._told_ns or (self._held and driven)):
            return None
        self._told_ns = heard_ns
        self._sequence += 1
        x, y, *more = (
            max(-1.0, min(1.0, position + moved))
            for position, moved in zip(self._positions, self._moved, strict=True)
        )
        return PageInput(
            self._held, x, y, self._buttons, self._sequence, heard_ns, more=tuple(more)
        )

    def _move(self, step_ns: int) -> None:
        for at, (name, half) in enumerate(zip(self._names, self._halves, strict=True)):
            # No twist has a gripper: it is moved by `/joy` alone.
            speed = self._velocity.get(name, 0.0)
            moved = self._moved[at] + speed * step_ns / NS_PER_S / half
            position = self._positions[at]
            self._moved[at] = max(-1.0 - position, min(1.0 - position, moved))
