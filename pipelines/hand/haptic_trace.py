"""The haptic samples of one end as they were, 1000 a second, for drawing and recording.

The 1 kHz loop appends a row in each cycle, but only while the topic has a reader. A block of rows
is packed at once, because packing row by row would cost several times as much.
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS
from pipelines.session.topic import Topic
from telepresence.haptics.axes import MOST_MORE_AXES
from telepresence.haptics.sample import SEQUENCE_MODULUS


class HapticChart(msgspec.Struct, frozen=True):
    """A chart of the pages. factor turns a value into `unit`; at least ±least of that is shown.

    column: of the rows that a page gets.
    """

    title: str
    unit: str
    factor: float
    least: float
    column: int = 0


class SampleField(NamedTuple):
    """A field of a cycle; float32. All that shows or keeps cycles derives from `FIELDS`.

    name: with its unit. what: meaning and unit in words. joystick, robot: where its value is at
    that end, an attribute of the `JoystickSide` or `RobotSide`; "unknown": nowhere, so NaN.
    chart: of the pages; None: it is not drawn. parameter, unit: in the robot's report of its state;
    "": it is not there.
    """

    name: str
    what: str
    joystick: str
    robot: str
    chart: HapticChart | None = None
    parameter: str = ""
    unit: str = ""


_PLACE_WORDS = "position of this end's handle or tip, m"
_FORCE_WORDS = "force that the handle displays, or of the board on the tip, N"
_CREDIT = "controller.credit_uj"
_PLANE: Final = ("x", "y")
FIRST_FIELDS: Final = (
    *(
        SampleField(f"{axis}_m", _PLACE_WORDS, f"handle.{axis}_m", f"robot.{axis}_m")
        for axis in _PLANE
    ),
    *(
        SampleField(f"f{axis}_n", _FORCE_WORDS, f"force_{axis}_n", f"robot.push_{axis}_n")
        for axis in _PLANE
    ),
    SampleField("energy_uj", "credit of this end's port, µJ", _CREDIT, _CREDIT),
)
#: A new one goes to the end, since recordings number them; older recordings do not have it.
LATER_FIELDS: Final[tuple[SampleField, ...]] = ()
FIELDS: Final = FIRST_FIELDS + LATER_FIELDS
#: One cycle. time_ns: its instant. flags: see `flags_of`. sent: number of the sample that this end
#: sent in the cycle. received: number of the newest sample that it acted on for the first time.
#: `NO_SAMPLE`: there was none.
ROW: Final = np.dtype(
    [
        ("time_ns", "<i8"),
        *((each.name, "<f4") for each in FIELDS),
        ("flags", "<u4"),
        ("sent", "<i4"),
        ("received", "<i4"),
    ]
)
NO_SAMPLE: Final = -1


def field_values(end: Literal["joystick", "robot"]) -> Callable[[Any], tuple[float, ...]]:
    """Return what takes the values of `FIELDS` from a side of this end."""
    paths = [getattr(each, end) for each in FIELDS]
    # One call of C for all of them, a thousand times a second.
    return attrgetter(*paths)


def axis_columns(place: str) -> tuple[str, str, str]:
    """Return the fields of an axis in a row: place, force, credit of its port.

    place: the first of them, such as `z_m` or `pan_rad`; its unit is that of the axis. x and y have
    one port.
    """
    name, _, unit = place.rpartition("_")
    if name in _PLANE:
        return place, f"f{name}_n", "energy_uj"
    return place, f"{name}_n" if unit == "m" else f"{name}_n_m", f"{name}_uj"


def charts_of(more: Sequence[str]) -> tuple[HapticChart, ...]:
    """Return the pages' charts, by title. more: the places of the axes behind x and y."""
    charts = {each.name: each.chart for each in FIELDS if each.chart is not None}
    for place in ("x_m", "y_m", *more):
        (name, _, unit), (_, force, _) = place.rpartition("_"), axis_columns(place)
        turned = unit == "rad"
        charts[force] = HapticChart(f"force {name}", *(("N m", 1, 0.1) if turned else ("N", 1, 1)))
        shown = ("rad", 1, 0.2) if turned else ("mm", 1000, 20)
        charts[place] = HapticChart(f"position {name}", *shown)
    columns = [each.name for each in FIELDS] + [one for at in more for one in axis_columns(at)]
    found = [replace(chart, column=columns.index(name)) for name, chart in charts.items()]
    return tuple(sorted(found, key=attrgetter("title")))


def row_type(places: Sequence[str]) -> "np.dtype[np.void]":
    """Return `ROW` with the fields of these axes, float32, at its end."""
    more = [(field, "<f4") for place in places for field in axis_columns(place)]
    return np.dtype(ROW.descr + more)


def places_of(columns: Iterable[str]) -> list[str]:
    """Return the place of each axis in the fields of rows or of a table, x and y first."""
    known = tuple(columns)
    return [place for place in ("x_m", "y_m") if place in known] + more_places(known)


def more_places(columns: Iterable[str]) -> list[str]:
    """Return the place of each axis behind x and y, likewise."""
    known = dict.fromkeys(columns)
    names = [one.removesuffix("_uj") for one in known if one.endswith("_uj")]
    places = [place for name in names for place in (f"{name}_m", f"{name}_rad")]
    return [place for place in places if place in known]


#: Rows of a block.
BLOCK_ROWS: Final = 20
#: With all axes. Behind the rows are the places of the axes as a text, and its length.
BLOCK_OCTETS: Final = BLOCK_ROWS * (ROW.itemsize + 12 * MOST_MORE_AXES) + 16 * MOST_MORE_AXES + 1


class HapticBlock(bytes):
    """Rows of a haptic trace, see `rows_of`."""


JOYSTICK_TRACE_TOPIC = Topic[bytes](
    "haptic/joystick", HapticBlock, "20 ms of the handle: position, force, energy (`rows_of`)"
)
ROBOT_TRACE_TOPIC = Topic[bytes](
    "haptic/robot", HapticBlock, "20 ms of the tip: position, force, energy (`rows_of`)"
)

CONTACT, DEAD_MAN, ACTED = 1, 2, 4
_STATE_BIT, _LIT_BIT = 8, 16

#: The fields of `ROW` up to `flags`; then, of this end of the link: samples sent before this cycle,
#: samples received, number of the newest of these; then the fields of the axes.
Row = Sequence[Any]
#: Where the first of these numbers is.
_NUMBERS: Final = len(FIELDS) + 2


def flags_of(*, contact: bool, dead_man: bool, acted: bool, state: int, lit: int | None) -> int:
    """Return the flags of a row.

    Bit 0: the tip touches something. Bit 1: the dead-man button is pressed. Bit 2: the passivity
    controller acted. Bits 8 to 11: number of the joystick's state. Bits 16 to 23: the lit LED,
    from 1; 0 for none.
    """
    # Called a thousand times a second, so it is one expression.
    return (
        (CONTACT if contact else 0)
        | (DEAD_MAN if dead_man else 0)
        | (ACTED if acted else 0)
        | (state << _STATE_BIT)
        | (0 if lit is None else (lit + 1) << _LIT_BIT)
    )


def state_of(flags: int) -> int:
    """Return the number of the joystick's state in a row's flags."""
    return flags >> _STATE_BIT & 0xF


def lit_of(flags: int) -> int | None:
    """Return the index of the lit LED in a row's flags, or None."""
    lit = flags >> _LIT_BIT & 0xFF
    return lit - 1 if lit else None


def rows_of(block: bytes) -> NDArray[np.void]:
    """Return a block as rows: (rows,), dtype `ROW` or `row_type` of its axes, read-only."""
    if len(block) % ROW.itemsize == 0:
        return np.frombuffer(block, ROW)
    end = len(block) - 1 - block[-1]
    return np.frombuffer(block[:end], row_type(block[end:-1].decode("ascii").split()))


_ASK_NS = 100 * NS_PER_MS


class WatchedTopic:
    """Whenever `asks` returns True, look for readers and call `handle_watched`.

    watched: the topic had readers when they were last looked for.
    """

    def __init__(self) -> None:
        self.watched = False
        self._ask_ns = 0

    def asks(self, now_ns: int) -> bool:
        """Whether it is time to look for readers: once in 100 ms."""
        if now_ns < self._ask_ns:
            return False
        self._ask_ns = now_ns + _ASK_NS
        return True

    def handle_watched(self, watched: bool) -> None:
        self.watched = watched


class HapticTrace(WatchedTopic):
    """Collects rows while somebody reads them.

    rows: those that wait, at most 21; None while there is no reader. In each cycle, call `add`
    while it is not None. Call `poll_block` at least once in 20 cycles. A block comes one cycle
    later, because only then is known whether its last cycle sent a sample.

    Nothing is dropped but the rows of a block that was begun when the last reader left.

    axes: the places of those behind x and y, as `axis_columns` takes them.
    """

    def __init__(self, axes: Sequence[str] = ()) -> None:
        super().__init__()
        self._pack = struct.Struct(
            "<" + (f"q{len(FIELDS)}fI2i" + 3 * len(axes) * "f") * BLOCK_ROWS
        ).pack
        text = " ".join(axes).encode("ascii")
        # Blocks of such a length have no more axes.
        text += b" " * ((len(text) + 1) % ROW.itemsize == 0)
        self._end = text + bytes([len(text)]) if axes else b""
        self.rows: list[Row] | None = None
        #: Samples received until the row before; None: there was none.
        self._received: int | None = None

    def handle_watched(self, watched: bool) -> None:
        """The topic has readers, or it has none."""
        if watched != self.watched:
            self.rows = [] if watched else None
            self._received = None
        super().handle_watched(watched)

    def add(self, row: Row) -> None:
        """Append a row; nothing without a reader."""
        if self.rows is not None:
            self.rows.append(row)

    def poll_block(self) -> bytes | None:
        """Return 20 rows as octets, or None while there are fewer."""
        rows = self.rows
        if rows is None or len(rows) <= BLOCK_ROWS:
            return None
        values: list[float] = []
        before = self._received
        for row, following in pairwise(rows[: BLOCK_ROWS + 1]):
            sent, received, newest = row[_NUMBERS : _NUMBERS + 3]
            values += row[:_NUMBERS]
            values.append(NO_SAMPLE if following[_NUMBERS] == sent else sent % SEQUENCE_MODULUS)
            values.append(NO_SAMPLE if before in (None, received) else newest)
            values += row[_NUMBERS + 3 :]
            before = received
        self._received = before
        del rows[:BLOCK_ROWS]
        return self._pack(*values) + self._end
