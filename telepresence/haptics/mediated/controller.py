"""The joystick's controller for model-mediated haptics: damping as before, force from the model.

The robot's delayed force is not displayed, or only what the model does not explain of it
(`residual`). Two energies are bounded, each alone: the motors never give the hand more than they
took from it (`WallRenderer`), and the robot never gets more than the hand put in. What the hand
puts into the rendered spring is granted to the robot, too, or it could not press. So the network as
a whole is not passive (docs/haptics-controllers.md).
"""

from math import hypot

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.mediated.renderer import RendererModel, WallRenderer
from telepresence.haptics.mediated.wall import parse_wall
from telepresence.haptics.sample import Feedback

_tuple = tuple.__new__
#: Less damping than `direct`: the wall's force takes its energy from the tank, not from the robot.
_MODEL = JoystickControllerModel(most_damping_n_s_m=8.0)
_RENDERING = RendererModel(limit_j=0.5, steepest_n_m=5000.0)
#: Fastest change of wall and rest together, and with the damping.
_MOST_N_S, _ALL_N_S = 1000.0, 1090.0
#: What the rest may give out at first beyond what the hand put in. The robot never gets it.
_START_J = 0.003
#: Damping at the start, until the robot is heard or a wall is felt, and its longest time. A hand
#: that has lost its wall sinks in against it, and so pays for the wall that comes back.
_BRAKE_N_S_M, _BRAKE_S = 120.0, 0.5
#: Filtered speed after the first cycle of a handle that moves already.
_MOVES_M_S = 0.01


class MediatedController(JoystickController):
    """A `JoystickController` whose force is that of the newest wall. Call `handle_wall` for each.

    residual: the feedback is what the wall does not explain, and is displayed, too.
    renderer: what it renders with. garbage: messages that were not a wall.
    """

    spared_j = 0.002 + _START_J

    def __init__(
        self,
        model: JoystickControllerModel | None = None,
        *,
        passive: bool = True,
        residual: bool = False,
    ) -> None:
        super().__init__(model or _MODEL, passive=passive)
        self.residual = residual
        self.renderer = WallRenderer(_RENDERING)
        self.garbage = 0
        self._damping_n = (0.0, 0.0)
        if passive:
            self.port.kept_j = self.port.credit_j = _START_J
        self._heard, self._braking = False, True
        #: The robot may not know the wall that is rendered: one of the two has just started.
        self._unknown = True
        self._before: tuple[float, float] | None = None

    @property
    def robot_force_n(self) -> tuple[float, float]:
        """The part of the present force (N, N) that is the robot's; the rest is damping."""
        wall_x, wall_y = self.renderer.force_n
        return wall_x + self._gx, wall_y + self._gy

    def handle_wall(self, datagram: bytes) -> None:
        """A message of the robot's side arrived. Garbage is counted; this never raises."""
        try:
            message = parse_wall(datagram)
        except ProtocolError:
            self.garbage += 1
            return
        # What comes before the robot is heard may be of its earlier life.
        self._unknown = self._unknown and not self._heard
        self.renderer.handle_wall(message)

    def handle_restart(self) -> None:
        """The robot has started. Its feedback is the whole force until it tells a wall again."""
        self._unknown = True

    def step(
        self, feedback: Feedback | None, x_m: float, y_m: float, dt_ns: int
    ) -> tuple[float, float]:
        """As in `JoystickController`; the force of `feedback` counts with `residual` only."""
        renderer, limit_n = self.renderer, self.limit_n
        before, self._before = self._before, (x_m, y_m)
        if before is not None:
            bx, by = self._damping_n
            renderer.handle_flow(bx * (x_m - before[0]) + by * (y_m - before[1]))
        renderer.limit_n = limit_n
        # A wall that rises must leave what the rest needs to fade.
        renderer.kept_j = self._fade_j()
        felt = feedback is None or not feedback[7]
        held_x, held_y = renderer.force_n
        wall_x, wall_y = renderer.step(x_m, y_m, dt_ns, felt=felt)
        turned_n_s = hypot(wall_x - held_x, wall_y - held_y) * NS_PER_S / dt_ns
        rate_n_s = max(0.0, min(self.model.rate_n_s, _MOST_N_S - turned_n_s))
        most_n_s = max(0.0, _ALL_N_S - turned_n_s)
        self._constants = (self._constants[0], rate_n_s, *self._constants[2:4], most_n_s)
        if feedback is not None and (not self.residual or (self._unknown and (wall_x or wall_y))):
            feedback = _tuple(Feedback, (0.0, 0.0, *feedback[2:]))
        # Rounding must not make it negative.
        self.limit_n = max(0.0, limit_n - hypot(wall_x, wall_y))
        self.most_j = renderer.spare_j
        self._damping_n = bx, by = super().step(feedback, x_m, y_m, dt_ns)
        self.limit_n = limit_n
        return wall_x + bx, wall_y + by

    def _follow_credit(self, feedback: Feedback | None, dt_s: float) -> None:
        super()._follow_credit(feedback, dt_s)
        self._heard = self._heard or feedback is not None
        if not self._braking:
            return
        known = self._heard or self.renderer.force_n != (0.0, 0.0)
        # A hand that moves already, or turns back, leans on no wall.
        moves = self._silent_s <= dt_s and hypot(self._vx, self._vy) > _MOVES_M_S
        turns = self._bx * self._vx + self._by * self._vy > 0.0
        self._braking = not (known or moves or turns or self._silent_s > _BRAKE_S)
        model = self.model
        self.damping_n_s_m = _BRAKE_N_S_M if self._braking else model.damping_n_s_m

    def _book(self, energy_j: float) -> None:
        """Count wall and damping together: what the wall gives back, the damper takes."""
        given_j = self.renderer.given_j
        # The tank pays for the rest of it.
        super()._book(energy_j + min(given_j, max(0.0, -energy_j)))
