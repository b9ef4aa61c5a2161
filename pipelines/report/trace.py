"""What a report of one end carries of its rows, so that two of them can be joined. A core.

All rows of a kind that the join needs, column by column: differences from row to row, octet planes
apart, zlib, Base64. An hour takes some 25 MB, most of it the stamps of haptic samples.
"""

from __future__ import annotations

import base64
import binascii
import zlib
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ProtocolError, refused
from pipelines.report.model import TraceBlock, TraceSeries
from pipelines.session.probe import Series
from pipelines.session.session_metrics import INSTANTS, LatenessRow, OutRow, Row, SendingRow
from telepresence.haptics.sample import SEQUENCE_MODULUS

#: By name in a report: all rows but those of one end alone.
TRACED: dict[str, type[Row]] = {
    kind.__name__.removesuffix("Row"): kind
    for kind in INSTANTS
    if kind not in (OutRow, LatenessRow, SendingRow)
}
_NAMES = {kind: name for name, kind in TRACED.items()}
#: A block is packed when it has as many values.
_BLOCK_VALUES = 1 << 16
#: The most values of a series that is read: 512 MB.
_MOST_VALUES = 1 << 26
#: Instants are in ns since 1970 or since a start: less than 300 years.
_MOST_NS = 1 << 63


class Trace:
    """The rows of one end's session."""

    def __init__(self) -> None:
        self._series: dict[tuple[str, type[Row], str], _Packed] = {}

    def add(self, process: str, series: Series[Any]) -> None:
        """A process has reported rows; those of kinds that no join needs are ignored."""
        if series.kind not in _NAMES or not series.values:
            return
        key = process, series.kind, series.stream
        packed = self._series.get(key)
        if packed is None:
            packed = self._series[key] = _Packed(series.width)
        packed.add(series.values)

    def report(self) -> list[TraceSeries]:
        return [
            TraceSeries(process=process, kind=_NAMES[kind], stream=stream, blocks=packed.blocks())
            for (process, kind, stream), packed in self._series.items()
        ]


class _Packed:
    def __init__(self, width: int) -> None:
        self._width = width
        self._blocks: list[TraceBlock] = []
        self._values = array("q")

    def add(self, values: array[int]) -> None:
        self._values.extend(values)
        if len(self._values) >= _BLOCK_VALUES:
            self._blocks.append(_pack(self._values, self._width))
            self._values = array("q")

    def blocks(self) -> list[TraceBlock]:
        rest = [_pack(self._values, self._width)] if self._values else []
        return [*self._blocks, *rest]


def _pack(values: array[int], width: int) -> TraceBlock:
    rows = np.frombuffer(values, "<i8").reshape(-1, width)
    steps = np.diff(rows, axis=0, prepend=np.zeros((1, width), "<i8"))
    # (column, octet of the value, row): what seldom changes lies together.
    planes = np.ascontiguousarray(steps.T).view(np.uint8).reshape(width, len(rows), 8)
    octets = zlib.compress(np.ascontiguousarray(planes.transpose(0, 2, 1)).tobytes())
    return TraceBlock(rows=len(rows), octets=base64.b64encode(octets).decode("ascii"))


def rows_of(series: TraceSeries) -> NDArray[np.int64]:
    """Return the rows, shape (n, columns). Raises ProtocolError if they are not of the kind."""
    kind = TRACED.get(series.kind)
    if kind is None:
        raise ProtocolError(f"there are no rows {series.kind!r}")
    width = len(kind._fields)
    total = sum(block.rows for block in series.blocks)
    if any(block.rows < 1 for block in series.blocks) or total * width > _MOST_VALUES:
        raise ProtocolError(f"{series.kind}: {total} rows")
    parts = [_unpack(block, width, series.kind) for block in series.blocks]
    rows = np.concatenate(parts) if parts else np.zeros((0, width), np.int64)
    _check(kind, rows)
    return rows


def _unpack(block: TraceBlock, width: int, name: str) -> NDArray[np.int64]:
    size = block.rows * width * 8
    with refused(name, binascii.Error, ValueError, zlib.error, raising=ProtocolError):
        packed = base64.b64decode(block.octets, validate=True)
        opener = zlib.decompressobj()
        octets = opener.decompress(packed, size + 1)
    if len(octets) != size:
        raise ProtocolError(f"{name}: a block of {block.rows} rows has {len(octets)} octets")
    planes = np.frombuffer(octets, np.uint8).reshape(width, 8, block.rows)
    steps = np.ascontiguousarray(planes.transpose(0, 2, 1)).view("<i8").reshape(width, block.rows)
    return np.cumsum(steps, axis=1, dtype=np.int64).T


def _check(kind: type[Row], rows: NDArray[np.int64]) -> None:
    """ProtocolError for values that no process tells."""
    for index, column in enumerate(kind._fields):
        values = rows[:, index]
        if column in INSTANTS[kind]:
            least, most = 0, _MOST_NS - 1
        elif column == "sequence":
            least, most = 0, SEQUENCE_MODULUS - 1
        elif column in ("octets", "packets", "slack_ns", "error_ns"):
            least, most = 0, 1 << 40
        else:
            least, most = -(1 << 61), 1 << 61
        if len(values) and (values.min() < least or values.max() > most):
            raise ProtocolError(f"{kind.__name__}: a value of {column} is out of range")
