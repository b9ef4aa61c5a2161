"""Tables as a MATLAB file: v5 by scipy, v7.3 by h5py (the extra `export`). A shell.

A table is a struct of column vectors; a column of texts is a cell array.
"""

from collections.abc import Mapping
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from kontur_av.errors import ConfigError
from pipelines.recording.export.columns import Column, Columns
from pipelines.recording.export.mat_v73 import write_v73
from pipelines.recording.export.outputs import Outputs
from pipelines.recording.export.tables import TableCollector
from pipelines.recording.joined import JoinedMessage, JoinedRecording

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
        """The file that will be there."""
        return [self._path]

    def begin(self, outputs: Outputs) -> None:
        """Try whether the file can be written."""
        self._unfinished = outputs.unfinished(self._path)

    def handle_message(self, message: JoinedMessage) -> None:
        """Take a message."""
        self._collector.handle_message(message)

    def end(self) -> None:
        """Write the file."""
        tables = self._collector.tables()
        self._rows = {name: len(table["session_ns"]) for name, table in tables.items()}
        self._v73 |= any(variable_octets(table) > MOST_V5_OCTETS for table in tables.values())
        write = write_v73 if self._v73 else write_v5
        write(self._unfinished, {"recording": about(self._recording), **tables})

    def lines(self) -> list[str]:
        """What was written, in words."""
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
    facts = recording.facts
    told = {} if facts is None else asdict(facts)
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
        {name: _struct(variable) for name, variable in variables.items()},
        appendmat=False,
        long_field_names=True,
        do_compression=True,
        oned_as="column",
    )


def _struct(variable: Variable) -> Mapping[str, Any]:
    return {name: _value(value) for name, value in variable.items()}


def _value(value: Column | str | float) -> Any:
    if isinstance(value, list):
        cells = np.empty((len(value), 1), object)
        cells[:, 0] = value
        return cells
    return np.int64(value) if isinstance(value, int) else value
