"""A simulated cosmonaut: does what panel and LED panel say, with a hand and a skill. A core.

The hand moves in minimum-jerk movements to where it wants to be (`telepresence.haptics.hand`). It
sees the LED panel in the picture that came to it, and corrects its aim a while after it sees a
miss. The ball and the partner's hand it seeks where the panel marks them. It feels the spring by
the pull of its own muscles. All parameters are chosen.
"""

from dataclasses import dataclass
from math import dist, hypot
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.board import LIGHTS_M
from telepresence.haptics.hand import SOFT_GRIP, TAP_TARGETS, Hand, HandModel, Waypoint
from telepresence.tasks.definitions import Curve, Pattern
from telepresence.tasks.panel import PanelView
from telepresence.tasks.panel_picture import DARK, PanelPicture
from telepresence.tasks.positions import curve_points
from telepresence.tmtc.k2aci import PanelMode, TaskGoal

#: Between two looks at panel and picture.
LOOK_NS = 20 * NS_PER_MS
#: How long a button is down.
_PRESS_NS = 120 * NS_PER_MS
#: The spring's place, before it yields, and how hard it is to be pulled.
_SPRING_X_M = -0.115
_PULL_N = 3.0
#: How far through the partner's hand it pushes.
_THROUGH_M = 0.03
#: It approaches the ball, or the hand that takes it, at its height, from beside it.
_LEVEL_M, _BESIDE_M, _CLEAR_M = 0.012, 0.09, 0.075
#: How far ahead on a curve the hand aims (points of `CURVE_POINTS`).
_AHEAD = 3
#: The farthest that the tip may be behind where the hand aims.
_BEHIND_M = 0.015


@dataclass(frozen=True, kw_only=True, slots=True)
class Skill:
    """level: 0, a beginner, to 1, trained. ConfigError otherwise."""

    level: float = 0.7

    def __post_init__(self) -> None:
        if not 0.0 <= self.level <= 1.0:
            raise ValueError(f"a skill is 0 to 1, not {self.level:g}")

    def _between(self, beginner: float, trained: float) -> float:
        return beginner + (trained - beginner) * self.level

    @property
    def reaction_ns(self) -> int:
        """From seeing something to acting on it."""
        return round(self._between(0.6, 0.25) * NS_PER_S)

    @property
    def speed_m_s(self) -> float:
        """Mean speed of an aimed movement."""
        return self._between(0.05, 0.15)

    @property
    def aim_m(self) -> float:
        """Standard deviation of where such a movement ends, on each axis."""
        return self._between(0.006, 0.0015)

    @property
    def follow_m_s(self) -> float:
        """Speed along a curve."""
        return self._between(0.02, 0.05)


class Cosmonaut(Hand):
    """The hand of a `HeldJoystick`, and what it presses.

    Call `look` every `LOOK_NS`, and pass `dead_man` on to the joystick.

    view: what the panel shows. picture: the LED panel, as it is seen. tip_m: of the robot, as seen.
    taps: it taps the targets until the panel shows its first task.

    pressed: how often the button was pressed.
    """

    def __init__(
        self, skill: Skill, *, seed: int, model: HandModel = SOFT_GRIP, taps: bool = False
    ) -> None:
        still = (Waypoint(0.0, 0.0, NS_PER_MS, NS_PER_MS),)
        super().__init__(model, script=TAP_TARGETS if taps else still)
        self.skill = skill
        self._taps = taps
        self._running = self._pressing = False
        self.pressed = 0
        self._pressed_ns = -_PRESS_NS
        self._random = Random(seed)
        self._mode: PanelMode | None = None
        self._mode_ns = 0
        self._picture = DARK
        self._picture_ns = 0
        self._begin = self._end = (0.0, 0.0)
        self._begun_ns = self._lasts_ns = self._now_ns = 0
        self._aimed_ns = 0
        self._wander = (0.0, 0.0)
        #: While it follows: its largest speed.
        self._track_m_s = 0.0
        self._curve: list[tuple[float, float]] = []
        self._at, self._onwards = 0.0, True
        #: Where tip and handle differ: the clutch may have taken them up apart.
        self._apart = (0.0, 0.0)
        self._pull_n = 0.0

    def force(
        self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float, dt_ns: int
    ) -> tuple[float, float]:
        """Advance by `dt_ns`; return the force (N, N) on a handle at (x_m, y_m)."""
        if self._taps:
            return super().force(x_m, y_m, vx_m_s, vy_m_s, dt_ns)
        self._now_ns += dt_ns
        self.buttons = int(self._now_ns - self._pressed_ns < _PRESS_NS)
        self._advance(dt_ns)
        stiffness, damping = self.model.stiffness_n_m, self.model.damping_n_s_m
        self._pull_n = stiffness * (x_m - self.x_m)
        return (
            stiffness * (self.x_m - x_m) + damping * (self.vx_m_s - vx_m_s),
            stiffness * (self.y_m - y_m) + damping * (self.vy_m_s - vy_m_s),
        )

    @property
    def dead_man(self) -> bool:
        """Whether it presses the dead-man button."""
        if self._taps:
            return self.grip.pressed
        return self._pressing and (self.grip.pressed or not self._running)

    def handle_robot(self, heard: bool, waiting: bool, x_m: float, y_m: float) -> None:
        """The robot is heard, or waits for a press; that matters in a run."""
        if self._taps:
            super().handle_robot(heard, waiting, x_m, y_m)
        elif self._running:
            self.grip.handle_robot(heard, waiting, self._now_ns)

    def look(
        self,
        view: PanelView,
        picture: PanelPicture,
        tip_m: tuple[float, float],
        handle_m: tuple[float, float],
    ) -> None:
        """See what is shown, and decide what to do."""
        now_ns = self._now_ns
        if self._taps:
            self.see(*tip_m)
            self._taps = not view.task
            return
        if view.mode is not self._mode:
            self._mode, self._mode_ns = view.mode, now_ns
        if picture != self._picture:
            moved = picture.pattern is self._picture.pattern is Pattern.SPOT
            self._picture = picture
            if not moved:
                self._picture_ns, self._curve = now_ns, []
        # Nobody acts on what has only just appeared.
        if now_ns - self._mode_ns < self.skill.reaction_ns:
            return
        self._act(view, tip_m, handle_m)

    def _act(
        self, view: PanelView, tip_m: tuple[float, float], handle_m: tuple[float, float]
    ) -> None:
        mode, now_ns = view.mode, self._now_ns
        running = mode is PanelMode.RUNNING
        if running and not self._running:
            self.grip.press(now_ns)
        self._running = running
        self._pressing = running or mode is PanelMode.PRESS_DEADMAN
        if mode in (PanelMode.TASK_INFO, PanelMode.FINISHED, PanelMode.ERROR):
            self.pressed += 1
            self._pressed_ns = now_ns
            # Once: the next press needs another reaction.
            self._mode_ns = now_ns
        elif mode in (PanelMode.MOVE_TO_START, PanelMode.HOLD, PanelMode.PRESS_DEADMAN):
            self.aim(view.start_m, within_m=0.002, seen_m=handle_m)
        elif mode is PanelMode.RUNNING and now_ns - self._picture_ns >= self.skill.reaction_ns:
            self._apart = tip_m[0] - handle_m[0], tip_m[1] - handle_m[1]
            if view.goal in (TaskGoal.HANDS, TaskGoal.BALL):
                if view.target_m is not None:
                    self._meet(view, view.target_m, tip_m)
            else:
                self._work(tip_m)

    def _meet(self, view: PanelView, at_m: tuple[float, float], tip_m: tuple[float, float]) -> None:
        """Go to the ball or the partner's hand from the right, where both hands' fingers are open;
        push the hand.
        """
        x_m, y_m = at_m
        if view.goal == TaskGoal.HANDS:
            x_m -= _THROUGH_M
        elif abs(tip_m[1] - y_m) > _LEVEL_M:
            # To the side first, so that neither ball nor fingers hit something on the way up.
            y_m = tip_m[1] if tip_m[0] < x_m + _CLEAR_M else y_m
            x_m += _BESIDE_M
        self.track(self._in_hand((x_m, y_m)), speed_m_s=self.skill.speed_m_s)

    def _work(self, tip_m: tuple[float, float]) -> None:
        picture = self._picture
        if picture.pattern is Pattern.LEDS and picture.leds:
            led = (picture.leds & -picture.leds).bit_length() - 1
            self.aim(LIGHTS_M[led], within_m=0.003, seen_m=tip_m)
        elif picture.pattern is Pattern.SPOT:
            self.track(self._in_hand(picture.spot_m), speed_m_s=2 * self.skill.speed_m_s)
        elif picture.pattern in (Pattern.CONTOUR, Pattern.LINE):
            curve = Curve.CONTOUR if picture.pattern is Pattern.CONTOUR else Curve.LINE
            self._follow(curve, tip_m)
        elif picture.pattern is Pattern.SPRING:
            self._pull(tip_m)
        elif picture.pattern is Pattern.FREE and self._now_ns - self._aimed_ns > NS_PER_S:
            self._aimed_ns = self._now_ns
            position = self._random.uniform(-0.08, 0.03), self._random.uniform(-0.05, 0.05)
            self._go(position, speed_m_s=self.skill.speed_m_s)

    def aim(
        self, position: tuple[float, float], *, within_m: float, seen_m: tuple[float, float]
    ) -> None:
        """Move to a place; after each movement look whether it is reached, and correct it."""
        if self._now_ns < self._begun_ns + self._lasts_ns + self.skill.reaction_ns:
            return
        miss_x, miss_y = position[0] - seen_m[0], position[1] - seen_m[1]
        if hypot(miss_x, miss_y) <= within_m:
            return
        # A short movement misses by less.
        share = min(1.0, hypot(miss_x, miss_y) / 0.04)
        error = self.skill.aim_m * share
        self._go(
            (
                self.x_m + miss_x + self._random.gauss(0.0, error),
                self.y_m + miss_y + self._random.gauss(0.0, error),
            ),
            speed_m_s=self.skill.speed_m_s,
        )

    def _follow(self, curve: Curve, tip_m: tuple[float, float]) -> None:
        """Lead the tip along a curve, from where it is nearest; a contour is closed."""
        if not self._curve:
            self._curve = curve_points(curve)
            self._at = float(
                min(range(len(self._curve)), key=lambda k: dist(self._curve[k], tip_m))
            )
        points, closed = self._curve, curve is Curve.CONTOUR
        ahead = round(self._at) + (_AHEAD if self._onwards else -_AHEAD)
        ahead = ahead % len(points) if closed else max(0, min(ahead, len(points) - 1))
        step_m = dist(points[ahead - 1], points[ahead])
        # It waits for a tip that stays behind.
        if dist(points[ahead], tip_m) < _BEHIND_M:
            step = self.skill.follow_m_s * LOOK_NS / NS_PER_S / max(step_m, 1e-6)
            self._at += step if self._onwards else -step
            # At the end of a line it goes back over what it may have missed.
            if not closed and not 0 <= self._at < len(points):
                self._onwards = not self._onwards
                self._at = min(max(self._at, 0.0), len(points) - 1.0)
        self.track(self._in_hand(points[ahead]), speed_m_s=2 * self.skill.follow_m_s)

    def _pull(self, tip_m: tuple[float, float]) -> None:
        """Pull at the spring until the muscles feel as much as they should."""
        missing_n = _PULL_N - self._pull_n if tip_m[0] < _SPRING_X_M + 0.01 else _PULL_N
        step_m = max(-0.004, min(0.004, 0.1 * missing_n / self.model.stiffness_n_m))
        y_m = self.y_m - 0.2 * tip_m[1]
        self._go((self.x_m - step_m, y_m), speed_m_s=self.skill.speed_m_s)

    def _in_hand(self, position: tuple[float, float]) -> tuple[float, float]:
        """Where the handle is to be for the tip to be at a place."""
        return position[0] - self._apart[0], position[1] - self._apart[1]

    def _go(self, position: tuple[float, float], *, speed_m_s: float) -> None:
        self._track_m_s = 0.0
        self._begin, self._end = (self.x_m, self.y_m), position
        way_m = dist(self._begin, position)
        self._begun_ns = self._now_ns
        # A minimum-jerk movement is no shorter than a twitch.
        self._lasts_ns = max(80 * NS_PER_MS, round(way_m / speed_m_s * NS_PER_S))

    def track(self, position: tuple[float, float], *, speed_m_s: float) -> None:
        """Follow what moves, at up to this speed; the hand is never quite where it wants to be."""
        wander, aim_m = self._wander, self.skill.aim_m
        # Its standard deviation settles at `aim_m`.
        self._wander = (
            0.95 * wander[0] + self._random.gauss(0.0, 0.31 * aim_m),
            0.95 * wander[1] + self._random.gauss(0.0, 0.31 * aim_m),
        )
        self._end = position[0] + self._wander[0], position[1] + self._wander[1]
        self._track_m_s = speed_m_s

    def _advance(self, dt_ns: int) -> None:
        if self._track_m_s:
            self._step_on_track(dt_ns)
            return
        if not self._lasts_ns:
            return
        s = (self._now_ns - self._begun_ns) / self._lasts_ns
        if s >= 1.0:
            self.x_m, self.y_m = self._end
            self.vx_m_s = self.vy_m_s = 0.0
            return
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) * NS_PER_S / self._lasts_ns
        (x0, y0), (x1, y1) = self._begin, self._end
        self.x_m, self.y_m = x0 + (x1 - x0) * share, y0 + (y1 - y0) * share
        self.vx_m_s, self.vy_m_s = (x1 - x0) * rate, (y1 - y0) * rate

    def _step_on_track(self, dt_ns: int) -> None:
        dx, dy = self._end[0] - self.x_m, self._end[1] - self.y_m
        way_m, most_m = hypot(dx, dy), self._track_m_s * dt_ns / NS_PER_S
        # Slower near the end: within 50 ms.
        step_m = min(most_m, way_m * dt_ns / (50 * NS_PER_MS))
        share = step_m / way_m if way_m > 1e-9 else 0.0
        self.vx_m_s, self.vy_m_s = (share * d * NS_PER_S / dt_ns for d in (dx, dy))
        self.x_m += share * dx
        self.y_m += share * dy
