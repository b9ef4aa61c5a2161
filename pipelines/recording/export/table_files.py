"""The tables of a recording as CSV files, and as a MATLAB file: v5 by scipy, v7.3 by h5py. A shell.

CSV has a line for each row, and units in the headings. The packages for MATLAB are of the extra
`export`.

A MATLAB table is a struct of column vectors; a column of texts is a cell array. A v7.3 file is HDF5
with a header and attributes of its own. MathWorks does not publish the format. Written after what
MATLAB's own files hold: a struct is a group, arrays have their dimensions reversed, a text is
UTF-16, a cell array refers to datasets.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from pipelines.recording.export.columns import (
    Column,
    Columnizer,
    Columns,
    Rows,
    joined,
    table_names,
)
from pipelines.recording.export.tables import RECORDING, TableCollector
from pipelines.recording.joined import JoinedMessage, JoinedRecording
from pipelines.recording.recorded_messages import LINK_SENT, PARAMETERS
from pipelines.recording.recording_file import Outputs

if TYPE_CHECKING:
    from _csv import Writer

#: Its columns may grow during a session, so it is written at the end.
_GROWING = {LINK_SENT.full_name, PARAMETERS.full_name}


class CsvExport:
    """A file for each channel that has messages, in one directory.

    Call `begin`, then `handle_message` for each message, then `end`.
    """

    def __init__(self, directory: Path, recording: JoinedRecording) -> None:
        self._directory = directory
        self._columnizer = Columnizer(recording.begin_ns)
        names = table_names(topic for topic, count in recording.counts.items() if count)
        self._topics = {topic: directory / f"{name}.csv" for topic, name in names.items()}
        self._files: dict[str, CsvFile] = {}

    @property
    def paths(self) -> list[Path]:
        return [*self._topics.values()]

    def begin(self, outputs: Outputs) -> None:
        outputs.make_directory(self._directory)
        for topic, path in self._topics.items():
            self._files[topic] = CsvFile(outputs.unfinished(path), self._columnizer)

    def handle_message(self, message: JoinedMessage) -> None:
        self._files[message.topic].handle_message(message)

    def end(self) -> None:
        for file in self._files.values():
            file.close()

    def lines(self) -> list[str]:
        return [f"{self._directory}: {len(self._files)} CSV files", *self._columnizer.lines()]


class CsvFile:
    """One channel as CSV (RFC 4180), written while it is read.

    Numbers have as many digits as are needed to read back the same value. True is 1, False is 0.
    """

    def __init__(self, path: Path, columnizer: Columnizer) -> None:
        self._file: TextIOWrapper = path.open("w", newline="", encoding="utf-8")
        self._writer: Writer = csv.writer(self._file)
        self._columnizer = columnizer
        self._headed = False
        self._waiting: list[Rows] = []

    def handle_message(self, message: JoinedMessage) -> None:
        rows = self._columnizer.rows(message)
        if rows is None:
            return
        if message.schema in _GROWING:
            self._waiting.append(rows)
        else:
            self._write(rows)

    def close(self) -> None:
        """Write what waits, and end the file."""
        if self._waiting:
            self._write(joined(self._waiting))
        self._file.close()

    def _write(self, rows: Rows) -> None:
        if not self._headed:
            self._writer.writerow(rows)
            self._headed = True
        self._writer.writerows(zip(*(_texts(column) for column in rows.values()), strict=True))


def _texts(column: Sequence[Any] | NDArray[Any]) -> Sequence[Any]:
    if not isinstance(column, np.ndarray):
        return column
    if column.dtype == np.bool_:
        column = column.astype(np.uint8)
    # The shortest text from which the same float32 is read; as a Python float it is longer.
    found: list[Any] = (column.astype("U") if column.dtype == np.float32 else column).tolist()
    return found


#: A variable of a v5 file has less; a struct is one variable.
MOST_V5_OCTETS = (1 << 31) - (1 << 20)
#: What a text of a cell array costs in a v5 file: its heads, and two octets a character.
_CELL_OCTETS, _CHARACTER_OCTETS = 64, 2

#: A struct's fields: columns, or single values.
Variable = Mapping[str, Column | str | float]


def check_packages() -> None:
    """Raise ConfigError if a package of the extra `export` is not installed."""
    missing = [name for name in ("scipy", "h5py") if find_spec(name) is None]
    if missing:
        raise ConfigError(f"--mat needs {' and '.join(missing)}: pip install 'kontur-av[export]'")


class MatExport:
    """All tables in one file, and the variable `recording`, which says where they come from.

    Call `begin`, then `handle_message` for each message, then `end`. v73: in the newer format, also
    where the older one would do.
    """

    def __init__(self, path: Path, recording: JoinedRecording, *, v73: bool = False) -> None:
        self._path = path
        self._recording = recording
        self._collector = TableCollector(recording.begin_ns)
        self._v73 = v73
        self._unfinished = path
        self._rows: dict[str, int] = {}

    @property
    def paths(self) -> list[Path]:
        return [self._path]

    def begin(self, outputs: Outputs) -> None:
        """Try whether the file can be written."""
        self._unfinished = outputs.unfinished(self._path)

    def handle_message(self, message: JoinedMessage) -> None:
        self._collector.handle_message(message)

    def end(self) -> None:
        tables = self._collector.tables()
        self._rows = {name: len(table["session_ns"]) for name, table in tables.items()}
        self._v73 |= any(variable_octets(table) > MOST_V5_OCTETS for table in tables.values())
        write = write_v73 if self._v73 else write_v5
        write(self._unfinished, {RECORDING: about(self._recording), **tables})

    def lines(self) -> list[str]:
        rows = ", ".join(f"{name} {count}" for name, count in sorted(self._rows.items()))
        return [
            f"{self._path}: {len(self._rows)} tables, MATLAB {'v7.3' if self._v73 else 'v5'}; "
            f"rows: {rows}",
            *self._collector.columnizer.lines(),
        ]


def about(recording: JoinedRecording) -> "Variable":
    """Return where a recording comes from, as fields of the variable `recording`.

    begin_session_ns, begin_wall_ns: the instant at which `time_s` is 0, on the session's clock and
    in ns since 1970 (UTC).
    """
    begin_ns = recording.begin_ns
    metadata = recording.metadata
    told = {} if metadata is None else asdict(metadata)
    for name in ("part", "session_ns", "wall_ns"):
        told.pop(name, None)
    return {
        **told,
        "parts": len(recording.parts),
        "begin_session_ns": begin_ns,
        "begin_wall_ns": begin_ns + recording.parts[0].wall_offset_ns,
        "row_numbers": "from 1; NaN: none",
    }


def variable_octets(columns: Columns) -> int:
    """Return how long a table is as a variable of a v5 file, not too low."""
    return sum(
        column.nbytes
        if isinstance(column, np.ndarray)
        else sum(_CELL_OCTETS + _CHARACTER_OCTETS * len(text) for text in column)
        for column in columns.values()
    )


def write_v5(path: Path, variables: Mapping[str, Variable]) -> None:
    """Write a MATLAB v5 file, compressed (that of MATLAB's `save -v7`); OSError if it fails."""
    from scipy.io import savemat

    savemat(
        path,
        {
            name: {one: _value(value) for one, value in variable.items()}
            for name, variable in variables.items()
        },
        appendmat=False,
        long_field_names=True,
        do_compression=True,
        oned_as="column",
    )


def _value(value: Column | str | float) -> Any:
    if isinstance(value, list):
        cells = np.empty((len(value), 1), object)
        cells[:, 0] = value
        return cells
    # Wall times of a foreign clock may take all 64 bits.
    return np.array(value) if isinstance(value, int) else value


#: HDF5 begins behind it.
_USER_BLOCK_OCTETS = 512
_HEADER = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created by: kontur-av HDF5 schema 1.00 ."
#: The text is padded to 116 octets, then come an unused offset, the version and the byte order.
_HEADER_OCTETS, _VERSION = 116, bytes(8) + b"\x00\x02IM"
_REFERENCES = "#refs#"
#: Columns with more rows are compressed.
_FEW_ROWS = 10_000
_CLASSES = {"float64": "double", "float32": "single"}


def write_v73(path: Path, variables: Mapping[str, Mapping[str, Column | str | float]]) -> None:
    """Write each variable as a struct of columns and single values; OSError if that fails."""
    import h5py

    with h5py.File(path, "w", userblock_size=_USER_BLOCK_OCTETS) as file:
        texts = _Texts(file)
        for name, variable in variables.items():
            group = file.create_group(name)
            _describe(group, "struct")
            fields = np.empty(len(variable), object)
            fields[:] = [np.frombuffer(field.encode(), "S1") for field in variable]
            group.attrs.create("MATLAB_fields", fields, dtype=h5py.vlen_dtype(np.dtype("S1")))
            for field, value in variable.items():
                _write(group, field, value, texts)
    with path.open("r+b") as octets:
        octets.write(_HEADER.ljust(_HEADER_OCTETS) + _VERSION)


class _Texts:
    """Texts to which cell arrays refer. Each is there once."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self._references: dict[str, object] = {}

    def reference(self, text: str) -> object:
        if text not in self._references:
            group = self._file.require_group(_REFERENCES)
            name = f"t{len(self._references)}"
            self._references[text] = _write_text(group, name, text).ref
        return self._references[text]


def _write(group: Any, name: str, value: Column | str | float, texts: _Texts) -> None:
    if isinstance(value, str):
        _write_text(group, name, value)
    elif isinstance(value, int | float):
        _write_numbers(group, name, np.array([value]))
    elif isinstance(value, list):
        _write_cells(group, name, value, texts)
    else:
        _write_numbers(group, name, value)


def _write_text(group: Any, name: str, text: str) -> Any:
    if not text:
        return _write_empty(group, name, (0, 0), "char")
    units = np.frombuffer(text.encode("utf-16-le", "replace"), np.uint16)
    data = group.create_dataset(name, data=units.reshape(-1, 1))
    _describe(data, "char", decode=2)
    return data


def _write_cells(group: Any, name: str, texts: list[str], kept: _Texts) -> None:
    import h5py

    if not texts:
        _write_empty(group, name, (0, 1), "cell")
        return
    references = np.empty((1, len(texts)), object)
    references[0] = [kept.reference(text) for text in texts]
    _describe(group.create_dataset(name, data=references, dtype=h5py.ref_dtype), "cell")


def _write_numbers(group: Any, name: str, column: NDArray[Any]) -> None:
    logical = column.dtype == np.bool_
    kind = "logical" if logical else _CLASSES.get(column.dtype.name, column.dtype.name)
    if not len(column):
        _write_empty(group, name, (0, 1), kind)
        return
    numbers = column.astype(np.uint8) if logical else column
    packing = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    options = packing if len(column) > _FEW_ROWS else {}
    data = group.create_dataset(name, data=numbers.reshape(1, -1), **options)
    _describe(data, kind, decode=1 if logical else None)


def _write_empty(group: Any, name: str, shape: tuple[int, int], kind: str) -> Any:
    """An empty array is a dataset of its dimensions."""
    data = group.create_dataset(name, data=np.array(shape, np.uint64))
    _describe(data, kind)
    data.attrs["MATLAB_empty"] = np.uint8(1)
    return data


def _describe(target: Any, kind: str, *, decode: int | None = None) -> None:
    target.attrs["MATLAB_class"] = np.bytes_(kind)
    if decode is not None:
        target.attrs["MATLAB_int_decode"] = np.int32(decode)
