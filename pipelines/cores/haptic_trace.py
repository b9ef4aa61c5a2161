"""The haptic samples of one end as they were, 1000 a second, for whoever draws or keeps them.

The 1 kHz loop appends a row in each cycle, but only while the topic has a reader. A block of rows
is packed at once, because packing row by row would cost several times as much.
"""

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pipelines.cores.watched_topic import WatchedTopic

#: One cycle. time_ns: its instant. x_m, y_m: place of the handle, or of the tip. fx_n, fy_n: the
#: force that the handle displays, or that of the board on the tip. energy_uj: credit of the port.
#: flags: see `flags_of`.
ROW: Final = np.dtype(
    [
        ("time_ns", "<i8"),
        ("x_m", "<f4"),
        ("y_m", "<f4"),
        ("fx_n", "<f4"),
        ("fy_n", "<f4"),
        ("energy_uj", "<f4"),
        ("flags", "<u4"),
    ]
)
#: Rows of a block.
BLOCK_ROWS: Final = 20
BLOCK_OCTETS: Final = BLOCK_ROWS * ROW.itemsize

CONTACT, DEAD_MAN, ACTED = 1, 2, 4
_STATE_BIT, _LIT_BIT = 8, 16
_PACK = struct.Struct("<" + "q5fI" * BLOCK_ROWS).pack

#: The fields of `ROW`, in their order.
Row = tuple[int, float, float, float, float, float, int]


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
    """Return a block as rows: (rows,), dtype `ROW`, read-only."""
    return np.frombuffer(block, ROW)


class HapticTrace(WatchedTopic):
    """Collects rows while somebody reads them.

    rows: those that wait, at most 20; None while there is no reader. In each cycle, call `add`
    while it is not None. Call `poll_block` at least once in 20 cycles.

    Nothing is dropped but the rows of a block that was begun when the last reader left.
    """

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[Row] | None = None

    def handle_watched(self, watched: bool) -> None:
        """The topic has readers, or it has none."""
        if watched != self.watched:
            self.rows = [] if watched else None
        super().handle_watched(watched)

    def add(self, row: Row) -> None:
        """Append a row; nothing without a reader."""
        if self.rows is not None:
            self.rows.append(row)

    def poll_block(self) -> bytes | None:
        """Return 20 rows as octets, or None while there are fewer."""
        rows = self.rows
        if rows is None or len(rows) < BLOCK_ROWS:
            return None
        block = rows[:BLOCK_ROWS]
        del rows[:BLOCK_ROWS]
        return _PACK(*(value for row in block for value in row))
