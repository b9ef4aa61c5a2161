"""More axes than x and y: the third direction, three rotations, a gripper.

Each of them is a port of its own: it has its own controllers, its own energies, and its own record
behind the 12 octets of a sample (docs/haptics-sample.md).

A rotation counts as the path at a lever of 0.1 m: 200 µrad and 0.2 mN m a count. So energies are
the same, and one controller serves all. Users see rad and N m (`AxisCapabilities`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Final, Literal, NamedTuple, Protocol

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError, one_of
from telepresence.haptics.sample import FORCE_N, POSITION_M, SAMPLE_OCTETS

#: Octets of one axis in a sample.
AXIS_OCTETS: Final = 5
#: A record carries at most this total (µJ).
MOST_AXIS_ENERGY_UJ: Final = (1 << 23) - 1
#: Turns rad into m, and N m into N (m).
LEVER_M: Final = 0.1

AxisName = Literal["z", "roll", "pitch", "yaw", "gripper"]
AXIS_NAMES: Final[tuple[AxisName, ...]] = ("z", "roll", "pitch", "yaw", "gripper")
_ROTATIONS: Final = ("roll", "pitch", "yaw")
_ACTED = 1 << 23
_LIMIT = 32767
_NEVER = -32768


def more_axes(axes: int, gripper: bool) -> tuple[AxisName, ...]:
    """Return the axes behind x and y of a setup. ConfigError for a number other than 2, 3, 6."""
    if axes not in (2, 3, 6):
        raise ConfigError(f"axes = {axes}: take 2, 3 or 6")
    return (*AXIS_NAMES[: axes - 2], *(AXIS_NAMES[-1:] if gripper else ()))


def sample_octets(more: int) -> int:
    """Return the octets of a sample with `more` axes behind x and y."""
    return SAMPLE_OCTETS + more * AXIS_OCTETS


def lever_of(name: str) -> float:
    """Return what turns the unit of an axis into m (1 for m, `LEVER_M` for rad)."""
    return LEVER_M if name in _ROTATIONS else 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class AxisCapabilities:
    """What one more axis of a robot or a joystick is: m and N, of rotations rad and N m.

    half_range: from its middle; 0 is the middle. force_limit: what its motor exerts.
    speed: per second, at most. Raises ConfigError for what cannot be.
    """

    name: AxisName
    half_range: float
    force_limit: float
    speed: float

    def __post_init__(self) -> None:
        one_of(self.name, AXIS_NAMES, "axis")
        for field in ("half_range", "force_limit", "speed"):
            value = getattr(self, field)
            if not 0.0 < value < 1000.0:
                raise ConfigError(f"axis {self.name}.{field} is {value:g}: take more than 0")

    @property
    def lever_m(self) -> float:
        return lever_of(self.name)


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


class AxisTotals:
    """The energies of all more axes on both ways, as `HapticLink` keeps those of x and y.

    Sent: of all sessions, and what of it was sent in earlier ones. Heard: likewise.
    """

    def __init__(self, more: int, *, robot: bool) -> None:
        self.octets = more * AXIS_OCTETS
        self._sends, self._hears = (FORCE_N, POSITION_M) if robot else (POSITION_M, FORCE_N)
        self._granted, self._granted_before = [0] * more, [0] * more
        self._heard, self._heard_before = [0] * more, [0] * more

    @property
    def most_uj(self) -> int:
        """The largest total of either way in this session, as x and y would count it."""
        here = (now - old for now, old in zip(self._granted, self._granted_before, strict=True))
        there = (now - old for now, old in zip(self._heard, self._heard_before, strict=True))
        # Their records have a bit less.
        return 2 * max(*here, *there)

    def handle_sending(self) -> None:
        """Samples go out in another session: each joule is granted in one only."""
        self._granted_before = list(self._granted)

    def handle_receiving(self) -> None:
        """Samples of another session are used."""
        self._heard_before = list(self._heard)

    def pack(self, values: Sequence[AxisValue]) -> bytes:
        """Return the octets of `values`, which are sent now."""
        self._granted = [energy_uj for _, energy_uj, _ in values]
        return pack_axes(values, self._granted_before, self._sends)

    def split(self, data: bytes) -> tuple[bytes, list[AxisValue]]:
        """Return the octets of x and y, and the axes; the energies are those of its session."""
        if len(data) != SAMPLE_OCTETS + self.octets:
            raise ProtocolError(f"haptic sample: {len(data)} octets with {self.octets} of axes")
        return data[:SAMPLE_OCTETS], read_axes(data[SAMPLE_OCTETS:], self._hears)

    def take(self, values: Sequence[AxisValue]) -> tuple[AxisValue, ...]:
        """Return `values` of the newest sample with the energies of all sessions heard."""
        taken = []
        for index, (value, energy_uj, acted) in enumerate(values):
            heard_uj = max(self._heard[index], self._heard_before[index] + energy_uj)
            self._heard[index] = heard_uj
            taken.append((value, heard_uj, acted))
        return tuple(taken)


class MoreAxis:
    """The state of one more axis, of a robot or of a handle; places and forces at its lever.

    position_m, speed_m_s: where it is. push_n: of a robot, the force of its surroundings.
    force_n: what its motor is to exert; set before each step. cut_n: within its limit.
    half_m, force_limit_n, most_m_s: its limits.
    """

    def __init__(self, capabilities: AxisCapabilities) -> None:
        self.capabilities = capabilities
        self.lever_m = lever_m = capabilities.lever_m
        self.half_m, self.most_m_s = capabilities.half_range * lever_m, capabilities.speed * lever_m
        self.force_limit_n = capabilities.force_limit / lever_m
        self.position_m = self.speed_m_s = self.push_n = self.force_n = 0.0
        self.contact = False

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
            limit = f"{capabilities.half_range:g}"
            return f"{capabilities.name} is at {position:.3g}, outside of its range of {limit}"
        if abs(speed) > _TOO_FAST * capabilities.speed:
            limit = f"{capabilities.speed:g}"
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


def built_in_axes(names: Sequence[AxisName], *, meets: bool) -> list[SimulatedAxis]:
    """Return the axes of the built-in robot (`meets`: its springs) or joystick."""
    return [SimulatedAxis(BUILT_IN_AXES[name], meets=meets) for name in names]


def check_axes(who: str, has: Sequence[AxisCapabilities], needed: Sequence[AxisName]) -> None:
    """Raise ConfigError unless `who` has exactly the axes that the setup names."""
    names = tuple(capabilities.name for capabilities in has)
    if names != tuple(needed):
        raise ConfigError(
            f"{who} has the axes {', '.join(('x', 'y', *names))}, but the setup has "
            f"{', '.join(('x', 'y', *needed))}: set axes and gripper of the setup as it has them"
        )
