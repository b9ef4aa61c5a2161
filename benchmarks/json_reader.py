"""Reads a JSON value by its keys."""

from collections.abc import Iterator, Mapping, Sequence


class JsonReader:
    """A JSON value whose parts are read by their keys, with the type checked.

    Every method raises ValueError, with the keys, where the value is missing or of another type.
    """

    def __init__(self, value: object, where: str = "report") -> None:
        self.value = value
        self._where = where

    def at(self, *keys: str) -> "JsonReader":
        """The part under `keys`, one after the other."""
        part = self
        for key in keys:
            if not isinstance(part.value, Mapping) or key not in part.value:
                raise ValueError(f"{part._where}: it has no {key!r}")
            part = JsonReader(part.value[key], f"{part._where}.{key}")
        return part

    def has(self, *keys: str) -> bool:
        """Whether there is a value other than null under `keys`."""
        try:
            return self.at(*keys).value is not None
        except ValueError:
            return False

    def number(self, *keys: str) -> float:
        value = self.at(*keys).value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{self._where}.{'.'.join(keys)}: {value!r} is no number")
        return value

    def count(self, *keys: str) -> int:
        """The whole number under `keys`."""
        return round(self.number(*keys))

    def items(self, *keys: str) -> Iterator[tuple[str, "JsonReader"]]:
        """Names and parts of the object under `keys`."""
        part = self.at(*keys)
        if not isinstance(part.value, Mapping):
            raise ValueError(f"{part._where}: no object")
        for name, value in part.value.items():
            yield str(name), JsonReader(value, f"{part._where}.{name}")

    def elements(self, *keys: str) -> Iterator["JsonReader"]:
        """The parts of the list under `keys`."""
        part = self.at(*keys)
        if isinstance(part.value, str) or not isinstance(part.value, Sequence):
            raise ValueError(f"{part._where}: no list")
        for number, value in enumerate(part.value):
            yield JsonReader(value, f"{part._where}[{number}]")
