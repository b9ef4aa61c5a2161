"""More axes than x and y: the third direction, three rotations, a gripper, a robot's own.

Each of them is a port of its own: it has its own controllers, its own energies, and its own record
behind the 12 octets of a sample (docs/wire-formats.md).

A rotation counts as the path at a lever of 0.1 m: 200 µrad and 0.2 mN m a count. So energies are
the same, and one controller serves all. Users see rad and N m (`AxisCapabilities`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import inf, isfinite
from typing import Final, Literal, NamedTuple, Protocol

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.haptics.sample import SAMPLE_OCTETS

#: Octets of one axis in a sample.
AXIS_OCTETS: Final = 5
#: A record carries at most this total (µJ).
MOST_AXIS_ENERGY_UJ: Final = (1 << 23) - 1
#: Turns rad into m, and N m into N (m).
LEVER_M: Final = 0.1

#: Of a path: m and N. Of a rotation: rad and N m.
AxisKind = Literal["linear", "rotary"]
#: Behind x and y. A robot may have up to `MOST_OWN_AXES` with names of its own.
AXIS_NAMES: Final = ("z", "roll", "pitch", "yaw", "gripper")
MOST_OWN_AXES: Final = 3
MOST_MORE_AXES: Final = len(AXIS_NAMES) + MOST_OWN_AXES
_PLANE: Final = ("x", "y")
_ROTATIONS: Final = ("roll", "pitch", "yaw")
_OWN_NAME: Final = re.compile("[a-z][a-z0-9]{1,10}")
#: In telemetry and tables these are something else.
_TAKEN: Final = ("error", "force", "hold", "mode", "contact", "partner", "powered", "energy")
_ACTED = 1 << 23
_LIMIT = 32767
_NEVER = -32768


@dataclass(frozen=True, kw_only=True, slots=True)
class AxisSettings:
    """What a setup says of an axis behind x and y; its table `[axis.NAME]`.

    kind: of a robot's own axis, linear or rotary; the others have theirs.
    mode: `position`: the axis follows the handle's. `rate`: the handle's deflection is the axis'
    speed, and the hand feels no force of it.
    scale: way of the robot's axis over that of the handle's, or its speed; below 0 it is turned.
    half_range, force_limit, speed: in m, N and m/s, or rad, N m and rad/s; the robot's own, if that
    is less. The range is from the middle.
    """

    kind: AxisKind | None = None
    mode: Literal["position", "rate"] = "position"
    scale: float = 1.0
    half_range: float | None = None
    force_limit: float | None = None
    speed: float | None = None


class AxisName(str):
    """The name of an axis, with its kind and what the setup says of it. It equals its plain text.

    Raises ConfigError for what cannot be.
    """

    kind: AxisKind
    settings: AxisSettings

    def __new__(cls, name: str, settings: AxisSettings | None = None) -> "AxisName":
        if isinstance(name, AxisName) and settings is None:
            return name
        self = super().__new__(cls, name)
        self.settings = settings = settings or AxisSettings()
        if name in AXIS_NAMES:
            self.kind = "rotary" if name in _ROTATIONS else "linear"
            if settings.kind not in (None, self.kind):
                raise ConfigError(f"axis {name} is {self.kind}: leave its kind out")
        elif not _OWN_NAME.fullmatch(name) or name in _TAKEN:
            raise ConfigError(
                f"axis {name!r}: take x, y, {', '.join(AXIS_NAMES)}, or a name of 2 to 11 lower-"
                "case letters and digits that telemetry does not use"
            )
        elif settings.kind is None:
            raise ConfigError(f'axis {name}: say what it is: [axis.{name}] kind = "rotary"')
        else:
            self.kind = settings.kind
        for field in fields(settings)[2:]:
            value = getattr(settings, field.name)
            least = -100.0 if field.name == "scale" else 0.0
            if value is not None and not (least < value < 1000.0 and value):
                raise ConfigError(f"axis.{name}.{field.name} is {value:g}: take more than 0")
        return self

    @property
    def place(self) -> str:
        """The field of its place in rows and tables, with its unit: `z_m`, `pan_rad`."""
        return f"{self}_{'m' if self.kind == 'linear' else 'rad'}"


def more_axes(axes: Sequence[str], settings: Mapping[str, AxisSettings]) -> tuple[AxisName, ...]:
    """Return the axes behind x and y of a setup, in its order. ConfigError."""
    for name in axes:
        if axes.count(name) > 1:
            raise ConfigError(f"axes: {name} is named twice")
    if not axes:
        raise ConfigError('axes is empty: take ["x", "y"]')
    for name in settings:
        if name not in axes or name in _PLANE:
            why = "safety has the limits of x and y" if name in _PLANE else "axes does not name it"
            raise ConfigError(f"[axis.{name}]: {why}: leave it out")
    more = tuple(AxisName(name, settings.get(name)) for name in axes if name not in _PLANE)
    if sum(name not in AXIS_NAMES for name in more) > MOST_OWN_AXES:
        raise ConfigError(f"axes: a robot has at most {MOST_OWN_AXES} with names of its own")
    return more


def sample_octets(more: int) -> int:
    """Return the octets of a sample with `more` axes behind x and y."""
    return SAMPLE_OCTETS + more * AXIS_OCTETS


#: The octets of the longest sample.
MOST_SAMPLE_OCTETS: Final = sample_octets(MOST_MORE_AXES)


def may_be_sample(data: bytes) -> bool:
    """Whether `data` has the length of a sample with any number of axes."""
    more = len(data) - SAMPLE_OCTETS
    return more >= 0 and more % AXIS_OCTETS == 0 and len(data) <= MOST_SAMPLE_OCTETS


@dataclass(frozen=True, kw_only=True, slots=True)
class AxisCapabilities:
    """What one more axis of a robot or a joystick is: m and N, of rotations rad and N m.

    half_range: from its middle; 0 is the middle. force_limit: what its motor exerts.
    speed: per second, at most. kind: of a robot's own, such as `pan`.
    Raises ConfigError for what cannot be.
    """

    name: str
    half_range: float
    force_limit: float
    speed: float
    kind: AxisKind | None = None

    def __post_init__(self) -> None:
        kind = AxisName(str(self.name), AxisSettings(kind=self.kind)).kind
        object.__setattr__(self, "kind", kind)
        for field in ("half_range", "force_limit", "speed"):
            value = getattr(self, field)
            if not 0.0 < value < 1000.0:
                raise ConfigError(f"axis {self.name}.{field} is {value:g}: take more than 0")

    @property
    def lever_m(self) -> float:
        """What turns its unit into m."""
        return LEVER_M if self.kind == "rotary" else 1.0

    @property
    def unit(self) -> str:
        return "rad" if self.kind == "rotary" else "m"


class AxisReading(NamedTuple):
    """What is measured of one more axis: m, m/s and N; of rotations rad, rad/s and N m.

    push: of its surroundings on a robot's axis. contact: it touches something.
    """

    position: float
    speed: float
    push: float = 0.0
    contact: bool = False


class MoreAxes(Protocol):
    """What a robot or a joystick has whose facts name more axes; in their order.

    Called in each cycle before `advance`, `read_more` after it. Nothing may block.
    """

    def read_more(self) -> Sequence[AxisReading]:
        """Return the newest measurement of each axis."""

    def write_more_forces(self, forces: Sequence[float]) -> None:
        """Exert this force (N; N m) on each axis until the next call."""

    def write_more_positions(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Follow these places; only of a robot that takes places."""


#: One axis in a sample: position (m) or force (N) at its lever, energy (µJ), and whether its
#: controller acted.
AxisValue = tuple[float, int, bool]


def pack_axes(values: Sequence[AxisValue], bases_uj: Sequence[int], count_of: float) -> bytes:
    """Return `AXIS_OCTETS` for each axis. count_of: m or N of one count.

    bases_uj: the part of each energy that was granted before this session.
    Raises ValueError for a value that is not a number: a bug of the caller.
    """
    data = bytearray()
    for (value, energy_uj, acted), base_uj in zip(values, bases_uj, strict=True):
        count = max(-_LIMIT, min(_LIMIT, round(value / count_of)))
        granted_uj = min(energy_uj - base_uj, MOST_AXIS_ENERGY_UJ)
        data += count.to_bytes(2, "big", signed=True)
        data += (granted_uj | (_ACTED if acted else 0)).to_bytes(3, "big")
    return bytes(data)


def read_axes(data: bytes, count_of: float) -> list[AxisValue]:
    """Parse what `pack_axes` packed; ProtocolError for a count that is never sent."""
    values: list[AxisValue] = []
    for at in range(0, len(data), AXIS_OCTETS):
        count = int.from_bytes(data[at : at + 2], "big", signed=True)
        if count == _NEVER:
            raise ProtocolError("haptic sample: the count -32768 is never sent")
        word = int.from_bytes(data[at + 2 : at + AXIS_OCTETS], "big")
        values.append((count * count_of, word & MOST_AXIS_ENERGY_UJ, word >= _ACTED))
    return values


def split_axes(data: bytes, more: int, count_of: float) -> tuple[bytes, list[AxisValue]]:
    """Return the octets of x and y, and the values of `more` axes behind them; ProtocolError."""
    if len(data) != sample_octets(more):
        raise ProtocolError(f"haptic sample: {len(data)} octets with {more} more axes")
    return data[:SAMPLE_OCTETS], read_axes(data[SAMPLE_OCTETS:], count_of)


class MoreAxis:
    """The state of one more axis, of a robot or of a handle; places and forces at its lever.

    position_m, speed_m_s: where it is. push_n: of a robot, the force of its surroundings.
    force_n: what its motor is to exert; set before each step. cut_n: within its limit.
    half_m, force_limit_n, most_m_s: its limits. rate, scale: as `AxisSettings` has them.
    """

    def __init__(self, capabilities: AxisCapabilities) -> None:
        self.capabilities = capabilities
        self.lever_m = lever_m = capabilities.lever_m
        self.half_m, self.most_m_s = capabilities.half_range * lever_m, capabilities.speed * lever_m
        self.force_limit_n = capabilities.force_limit / lever_m
        self.position_m = self.speed_m_s = self.push_n = self.force_n = 0.0
        self.contact = self.rate = False
        self.scale = 1.0

    def set_up(self, settings: AxisSettings, *, limits: bool) -> None:
        """Take what the setup says. limits: of a robot's axis, also the limits and the scale."""
        self.rate = settings.mode == "rate"
        if not limits:
            return
        self.scale, lever_m = settings.scale, self.lever_m
        self.half_m = min(self.half_m, (settings.half_range or inf) * lever_m)
        self.most_m_s = min(self.most_m_s, (settings.speed or inf) * lever_m)
        self.force_limit_n = min(self.force_limit_n, (settings.force_limit or inf) / lever_m)

    @property
    def cut_n(self) -> float:
        return max(-self.force_limit_n, min(self.force_limit_n, self.force_n))

    def take(self, reading: AxisReading) -> str:
        """Stand where `reading` says; return "", or why it cannot be believed."""
        position, speed, push, contact = reading
        if not (isfinite(position) and isfinite(speed) and isfinite(push)):
            return f"a measurement of {self.capabilities.name} is not a number"
        capabilities = self.capabilities
        if abs(position) > _TOO_FAR * capabilities.half_range:
            limit = f"{capabilities.half_range:g} {capabilities.unit}"
            return f"{capabilities.name} is at {position:.3g}, outside of its range of {limit}"
        if abs(speed) > _TOO_FAST * capabilities.speed:
            limit = f"{capabilities.speed:g} {capabilities.unit}/s"
            return f"{capabilities.name} moves at {speed:.3g}, beyond twice its speed of {limit}"
        lever_m = self.lever_m
        self.position_m, self.speed_m_s, self.push_n = (
            position * lever_m,
            speed * lever_m,
            push / lever_m,
        )
        self.contact = contact
        return ""


#: Beyond these shares of its own limits a reading is an error.
_TOO_FAR, _TOO_FAST = 1.05, 2.0
#: Of the built-in robot and joystick; chosen.
BUILT_IN_AXES: Final = {
    "z": AxisCapabilities(name="z", half_range=0.10, force_limit=12.0, speed=0.5),
    "roll": AxisCapabilities(name="roll", half_range=1.0, force_limit=0.8, speed=3.0),
    "pitch": AxisCapabilities(name="pitch", half_range=1.0, force_limit=0.8, speed=3.0),
    "yaw": AxisCapabilities(name="yaw", half_range=1.0, force_limit=0.8, speed=3.0),
    "gripper": AxisCapabilities(name="gripper", half_range=0.04, force_limit=12.0, speed=0.3),
}


def built_in_axis(name: str) -> AxisCapabilities:
    """Return that axis of the built-in robot and joystick; a robot's own as z, or as yaw."""
    own = AxisName(name)
    if own in BUILT_IN_AXES:
        return BUILT_IN_AXES[own]
    like = BUILT_IN_AXES["yaw" if own.kind == "rotary" else "z"]
    return replace(like, name=str(own), kind=own.kind)


#: Where on the positive side of its range an axis of the built-in robot meets a spring.
_OBJECT = 0.5
_OBJECT_N_M = 600.0
_MASS_KG = 0.5
_FRICTION_N_S_M = 1.0


class SimulatedAxis(MoreAxis):
    """A mass on a guide with friction.

    meets: a spring at half of its range gives `push_n`; else the caller does.
    """

    def __init__(self, capabilities: AxisCapabilities, *, meets: bool) -> None:
        super().__init__(capabilities)
        self._meets = meets

    def step(self, force_n: float, dt_ns: int) -> None:
        """Advance by `dt_ns`, at most 1 ms, with this force of motor and hand together."""
        dt_s = dt_ns / NS_PER_S
        if self._meets:
            over_m = self.position_m - _OBJECT * self.half_m
            self.contact = over_m > 0.0
            self.push_n = -_OBJECT_N_M * over_m if self.contact else 0.0
        self.speed_m_s += (
            (force_n + self.push_n - _FRICTION_N_S_M * self.speed_m_s) / _MASS_KG * dt_s
        )
        self.position_m += self.speed_m_s * dt_s


def built_in_axes(names: Sequence[str], *, meets: bool) -> list[SimulatedAxis]:
    """Return the axes of the built-in robot (`meets`: its springs) or joystick."""
    return [SimulatedAxis(built_in_axis(name), meets=meets) for name in names]


def set_up_axes(axes: Sequence[MoreAxis], names: Sequence[str], *, limits: bool) -> None:
    """Give each axis what the setup says of it, as `MoreAxis.set_up` does."""
    for axis, name in zip(axes, names, strict=False):
        axis.set_up(AxisName(name).settings, limits=limits)


def check_axes(who: str, has: Sequence[AxisCapabilities], needed: Sequence[str]) -> None:
    """Raise ConfigError unless `who` has exactly the axes that the setup names behind x and y."""
    names = tuple(capabilities.name for capabilities in has)
    if names != tuple(needed):
        own = "".join(
            f', [axis.{one.name}] kind = "{one.kind}"' for one in has if one.name not in AXIS_NAMES
        )
        fit = ", ".join(f'"{name}"' for name in ("x", "y", *names))
        raise ConfigError(
            f"{who} has the axes {', '.join(('x', 'y', *names))}, but the setup has "
            f"{', '.join(('x', 'y', *needed))}: set axes = [{fit}]{own} in the setup"
        )
    for one, name in zip(has, map(AxisName, needed), strict=True):
        if one.kind != name.kind:
            raise ConfigError(f"{who}: {name} is {one.kind}: set [axis.{name}] kind so")
