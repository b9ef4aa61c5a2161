"""MATLAB v7.3 files by h5py: HDF5 with a header and attributes of its own. A shell.

MathWorks does not publish the format. Written after what MATLAB's own files hold: a struct is a
group, arrays have their dimensions reversed, a text is UTF-16, a cell array refers to datasets.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.recording.export.columns import Column

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
        """Return a reference to a text."""
        if text not in self._references:
            group = self._file.require_group(_REFERENCES)
            name = f"t{len(self._references)}"
            self._references[text] = _write_text(group, name, text).ref
        return self._references[text]


def _write(group: Any, name: str, value: Column | str | float, texts: _Texts) -> None:
    if isinstance(value, str):
        _write_text(group, name, value)
    elif isinstance(value, int):
        _write_numbers(group, name, np.array([value], np.int64))
    elif isinstance(value, float):
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
