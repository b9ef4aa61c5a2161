"""The haptic samples of one end as they were, 1000 a second, for drawing and recording.

The 1 kHz loop appends a row in each cycle, but only while the topic has a reader. A block of rows
is packed at once, because packing row by row would cost several times as much.
"""

import struct
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS
from pipelines.session.topic import Topic
from telepresence.haptics.axes import MOST_MORE_AXES
from telepresence.haptics.sample import SEQUENCE_MODULUS

#: One cycle. time_ns: its instant. x_m, y_m: place of the handle, or of the tip. fx_n, fy_n: the
#: force that the handle displays, or that of the board on the tip. energy_uj: credit of the port.
#: flags: see `flags_of`. sent: number of the sample that this end sent in the cycle. received:
#: number of the newest sample that it acted on for the first time. `NO_SAMPLE`: there was none.
ROW: Final = np.dtype(
    [
        ("time_ns", "<i8"),
        ("x_m", "<f4"),
        ("y_m", "<f4"),
        ("fx_n", "<f4"),
        ("fy_n", "<f4"),
        ("energy_uj", "<f4"),
        ("flags", "<u4"),
        ("sent", "<i4"),
        ("received", "<i4"),
    ]
)
NO_SAMPLE: Final = -1


def axis_columns(place: str) -> tuple[str, str, str]:
    """Return the fields of an axis behind x and y in a row: place, force, credit of its port.

    place: the first of them, such as `z_m` or `pan_rad`; its unit is that of the axis.
    """
    name, _, unit = place.rpartition("_")
    return place, f"{name}_n" if unit == "m" else f"{name}_n_m", f"{name}_uj"


def row_type(places: Sequence[str]) -> "np.dtype[np.void]":
    """Return `ROW` with the fields of these axes, float32, at its end."""
    more = [(field, "<f4") for place in places for field in axis_columns(place)]
    return np.dtype(ROW.descr + more)


def places_of(columns: Iterable[str]) -> list[str]:
    """Return the place of each axis behind x and y in the fields of rows or of a table."""
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
        self._pack = struct.Struct("<" + ("q5fI2i" + 3 * len(axes) * "f") * BLOCK_ROWS).pack
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
            sent, received, newest = row[7:10]
            values += row[:7]
            values.append(NO_SAMPLE if following[7] == sent else sent % SEQUENCE_MODULUS)
            values.append(NO_SAMPLE if before in (None, received) else newest)
            values += row[10:]
            before = received
        self._received = before
        del rows[:BLOCK_ROWS]
        return self._pack(*values) + self._end
