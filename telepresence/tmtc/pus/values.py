"""Values of parameters as octets: integers, scaled ones, floating point, choices, flags, texts."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite

from kontur_av.errors import ConfigError, ProtocolError

Value = int | float | bool | str

#: Type -> struct code, smallest and largest integer on the wire.
INTEGERS = {
    "u8": ("B", 0, 0xFF),
    "u16": ("H", 0, 0xFFFF),
    "u32": ("I", 0, 0xFFFF_FFFF),
    "i8": ("b", -0x80, 0x7F),
    "i16": ("h", -0x8000, 0x7FFF),
    "i32": ("i", -0x8000_0000, 0x7FFF_FFFF),
}
TYPES = (*INTEGERS, "f32", "bool", "choice", "text")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter of an application.

    type: one of `TYPES`. scale: the value is the integer on the wire times this; 1 keeps integers.
    choices: the texts that a "choice" may have, in the order of their numbers; those that a "text"
    may have, or none for any. size: a "text" has 1 to so many octets of printable ASCII; a zero
    ends it, and zeros fill it up.
    low, high: limits for colours, both included; None for no limit. writable: ST[20] may set it.
    """

    name: str
    number: int
    type: str
    unit: str = ""
    scale: float = 1.0
    choices: tuple[str, ...] = ()
    size: int = 0
    low: float | None = None
    high: float | None = None
    writable: bool = False
    text: str = ""

    @property
    def octets(self) -> int:
        """Its length on the wire."""
        return struct.calcsize(self.code)

    @property
    def code(self) -> str:
        """Its struct code, big-endian."""
        if self.type in INTEGERS:
            return ">" + INTEGERS[self.type][0]
        if self.type == "text":
            return f">{self.size + 1}s"
        return ">f" if self.type == "f32" else ">B"

    def pack(self, value: Value) -> bytes:
        """Return `value` as octets. A number out of range is cut to it; ConfigError otherwise."""
        if self.type == "text":
            return self._pack_text(value)
        if self.type == "choice":
            if value not in self.choices:
                choices = ", ".join(self.choices)
                raise ConfigError(f"{self.name} is {value!r}: choose one of {choices}")
            return bytes([self.choices.index(str(value))])
        if self.type == "bool":
            if type(value) is not bool:
                raise ConfigError(f"{self.name} is {value!r}: give true or false")
            return bytes([value])
        if isinstance(value, str) or type(value) is bool:
            raise ConfigError(f"{self.name} is {value!r}: give a number")
        if self.type == "f32":
            return _pack_float(value)
        _, least, most = INTEGERS[self.type]
        if not isfinite(value):
            raise ConfigError(f"{self.name} is {value}: give a finite number")
        return struct.pack(self.code, max(least, min(most, round(value / self.scale))))

    def unpack(self, octets: bytes) -> Value:
        """Return the value in `octets`, which are `self.octets` long. ProtocolError."""
        if self.type == "text":
            return self._unpack_text(octets)
        raw: int | float = struct.unpack(self.code, octets)[0]
        if self.type == "choice":
            if raw >= len(self.choices):
                raise ProtocolError(f"{self.name}: {raw} is no choice")
            return self.choices[int(raw)]
        if self.type == "bool":
            if raw > 1:
                raise ProtocolError(f"{self.name}: {raw} is neither true nor false")
            return bool(raw)
        if self.type == "f32" or self.scale == 1:
            return float(raw) if self.type == "f32" else int(raw)
        # Rounded, so that 6294 times 0.00001 is 0.06294.
        return round(float(raw) * self.scale, 9)

    def check(self, value: Value) -> None:
        """Raise ProtocolError, with the limits, unless `value` is finite and within them.

        For what a telecommand asks for. On the wire a limit of an "f32" is a little above or below.
        """
        if isinstance(value, str):
            return
        low = -inf if self.low is None else self._sent(self.low)
        high = inf if self.high is None else self._sent(self.high)
        if isfinite(value) and low <= value <= high:
            return
        sides = {"at least": self.low, "at most": self.high}
        known = " and ".join(f"{side} {at:g}" for side, at in sides.items() if at is not None)
        raise ProtocolError(f"{self.name} is {value:g}: give {known or 'a finite number'}")

    def _sent(self, limit: float) -> float:
        if self.type != "f32":
            return limit
        (sent,) = struct.unpack(">f", _pack_float(limit))
        return float(sent)

    def _pack_text(self, value: Value) -> bytes:
        if self.choices and value not in self.choices:
            choices = ", ".join(self.choices)
            raise ConfigError(f"unknown {self.name} {value}: choose one of {choices}")
        if type(value) is not str or not _is_text(value, self.size):
            raise ConfigError(
                f"{self.name} is {value!r}: give 1 to {self.size} printable ASCII characters"
            )
        return value.encode("ascii").ljust(self.octets, b"\0")

    def _unpack_text(self, octets: bytes) -> str:
        # latin-1 reads any octet; those outside of ASCII are refused next.
        value = octets.rstrip(b"\0").decode("latin-1")
        if not _is_text(value, self.size):
            raise ProtocolError(f"{self.name} is not 1 to {self.size} printable ASCII characters")
        if self.choices and value not in self.choices:
            raise ProtocolError(
                f"unknown {self.name} {value}: choose one of {', '.join(self.choices)}"
            )
        return value


def _is_text(value: str, size: int) -> bool:
    return 1 <= len(value) <= size and value.isascii() and value.isprintable()


def _pack_float(value: float) -> bytes:
    try:
        return struct.pack(">f", value)
    except OverflowError:
        return struct.pack(">f", float("inf") if value > 0 else float("-inf"))


def pack_values(parameters: Sequence[Parameter], values: Sequence[Value]) -> bytes:
    """Return the values of `parameters` one after the other. ConfigError."""
    if len(parameters) != len(values):
        names = ", ".join(parameter.name for parameter in parameters) or "nothing"
        raise ConfigError(f"{len(values)} values: give {names}")
    return b"".join(one.pack(value) for one, value in zip(parameters, values, strict=True))


def unpack_values(parameters: Sequence[Parameter], octets: bytes) -> tuple[Value, ...]:
    """Return the values in `octets`; ProtocolError unless they fill them exactly."""
    if len(octets) != sum(parameter.octets for parameter in parameters):
        raise ProtocolError(f"{len(octets)} octets for {len(parameters)} parameters")
    values, at = [], 0
    for parameter in parameters:
        values.append(parameter.unpack(octets[at : at + parameter.octets]))
        at += parameter.octets
    return tuple(values)
