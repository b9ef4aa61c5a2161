"""Channels of a recording as CSV files: a line for each row, units in the headings. A shell."""

import csv
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipelines.recording.export.columns import Columnizer, Rows, joined, table_names
from pipelines.recording.joined import JoinedMessage, JoinedRecording
from pipelines.recording.messages import LINK_SENT
from pipelines.recording.recording_file import Outputs

if TYPE_CHECKING:
    from _csv import Writer

#: Its columns may grow during a session, so it is written at the end.
_GROWING = {LINK_SENT.full_name}


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
