"""The state of the task board. All lengths in metres, in the board's coordinates.

The board lies in the plane z = 0. The origin is its centre, x points to the right, y up (away from
the viewer in front of it), z towards the viewer.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from kontur_av.clock import NS_PER_S
from telepresence.haptics.board import LED_REACH_M as LED_REACH_M
from telepresence.haptics.board import LEDS_M as LEDS_M
from telepresence.haptics.board import WALL_X_M as WALL_X_M

BOARD_WIDTH_M = 0.30
BOARD_HEIGHT_M = 0.20


@dataclass(frozen=True, slots=True)
class Lights:
    """What shines on the board for a task. positions_m: centres of round lights of `radius_m`."""

    positions_m: tuple[tuple[float, float], ...] = ()
    radius_m: float = 0.005
    colour: tuple[int, int, int] = (255, 255, 255)


@dataclass(frozen=True, slots=True)
class WorldState:
    """What the cameras see and the microphones hear at one instant.

    time_ns: the instant.
    x_m, y_m: tip of the stylus.
    force_n: reaction of the wall, >= 0.
    contact: the tip pushes against the wall.
    contact_since_ns: when the contact began, if known.
    touched_ns: when the newest contact began, even if it has ended. The microphone's click begins
    at that sample.
    lights: of the LED panel.
    holds: the robot's hand holds a ball.
    """

    time_ns: int
    x_m: float = 0.0
    y_m: float = 0.0
    force_n: float = 0.0
    contact: bool = False
    contact_since_ns: int | None = None
    touched_ns: int | None = None
    lights: Lights = Lights()
    holds: bool = False

    @property
    def click_ns(self) -> int | None:
        """When the newest click of the stylus began; None without one."""
        return self.contact_since_ns if self.touched_ns is None else self.touched_ns

    def at(self, instant_ns: int) -> "WorldState":
        """Return the state without a contact that began after `instant_ns`.

        A camera asks shortly after its capture instant. It must not show an LED that was lit only
        in between.
        """
        since_ns = self.contact_since_ns
        if not self.contact or since_ns is None or since_ns <= instant_ns:
            return self
        return replace(self, force_n=0.0, contact=False, contact_since_ns=None)

    def dated(self) -> "WorldState":
        """Return the state in which a contact without a beginning begins now."""
        if not self.contact:
            return self
        since_ns = self.time_ns if self.contact_since_ns is None else self.contact_since_ns
        touched_ns = since_ns if self.touched_ns is None else self.touched_ns
        return replace(self, contact_since_ns=since_ns, touched_ns=touched_ns)

    @property
    def lit(self) -> int | None:
        """Index into LEDS_M of the lit target: touched, in contact. None: all are dark."""
        if not self.contact:
            return None
        distances = [math.hypot(self.x_m - x, self.y_m - y) for x, y in LEDS_M]
        nearest = min(range(len(LEDS_M)), key=distances.__getitem__)
        return nearest if distances[nearest] <= LED_REACH_M else None


#: now_ns -> the state at that instant. The robot's process writes it, the cameras read it.
StateAt = Callable[[int], WorldState]

_TOUR_NS = 12 * NS_PER_S
_PRESS_S = 0.7
_STIFFNESS_N_PER_M = 800.0
_DEEPEST_M = 0.004


def scripted_state(now_ns: int) -> WorldState:
    """Return the stylus's state when no robot moves it.

    It follows a tour of 12 s with three taps, 4 s apart, one on each target of the wall. In between
    it moves along a Lissajous figure to the left of the wall.
    """
    tour, in_tour_ns = divmod(now_ns, _TOUR_NS)
    leg, in_leg_ns = divmod(in_tour_ns, _TOUR_NS // 3)
    leg_s = _TOUR_NS / 3 / NS_PER_S
    t = in_leg_ns / NS_PER_S
    target_y = LEDS_M[leg][1]
    press_begin_s = (leg_s - _PRESS_S) / 2
    if press_begin_s <= t < press_begin_s + _PRESS_S:
        depth = _DEEPEST_M * math.sin(math.pi * (t - press_begin_s) / _PRESS_S)
        since_ns = tour * _TOUR_NS + leg * (_TOUR_NS // 3) + int(press_begin_s * NS_PER_S)
        force_n = _STIFFNESS_N_PER_M * depth
        return WorldState(now_ns, WALL_X_M, target_y, force_n, True, since_ns, since_ns)
    # Free motion: a loop from the last target to the next one.
    free_s = leg_s - _PRESS_S
    after = t >= press_begin_s + _PRESS_S
    s = (t - press_begin_s - _PRESS_S if after else t + free_s / 2) / free_s
    y_from = LEDS_M[leg if after else (leg - 1) % 3][1]
    y_to = LEDS_M[(leg + 1) % 3 if after else leg][1]
    ease = s * s * (3 - 2 * s)
    x = WALL_X_M - 0.065 * (1 - math.cos(2 * math.pi * s))
    y = y_from + (y_to - y_from) * ease + 0.035 * math.sin(4 * math.pi * s)
    return WorldState(now_ns, min(x, WALL_X_M), y)
