"""What a recording says of itself, as a metadata record that carries a check. A core.

MCAP gives metadata no check of its own. So one of its items is the CRC-32 of the others.
"""

from binascii import crc32
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Self

from kontur_av import __version__
from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.sources.recorded_format import FORMAT

#: Who writes a file, in its header.
LIBRARY = f"kontur-av {__version__}"
#: Names of metadata records: the facts of a recording, and what a fixed one has lost.
METADATA, REPAIRED = "kontur-av", "kontur-av fixed"
_CHECK = "crc32"


@dataclass(frozen=True, kw_only=True)
class RecordingMetadata:
    """Where a recording comes from.

    setup: its name; setup_toml: all of it. version: of kontur-av. command: the command line.
    part: counts the files of a recording from 1.
    session_ns, wall_ns: the same instant on the session's clock and in wall time. Their difference
        is fixed for the whole recording, so differences of wall times are true durations.
    started_ns: when the session began, on its clock, which is time 0 of its radio; 0: not known.
    radio_start_s: how long after its acquisition of signal the radio's contact was at that time.
    """

    session: str
    setup: str
    setup_toml: str
    version: str
    seed: int
    command: str
    part: int
    session_ns: int
    wall_ns: int
    started_ns: int = 0
    radio_start_s: float = 0.0

    def is_of(self, other: Self) -> bool:
        """Whether both are of one session; its recorder reads the clocks once."""
        moved_ns = (self.wall_ns - self.session_ns) - (other.wall_ns - other.session_ns)
        return abs(moved_ns) < NS_PER_S and all(
            getattr(self, name) == getattr(other, name)
            for name in ("session", "setup", "seed", "started_ns")
        )

    def items(self) -> dict[str, str]:
        """Return them for a metadata record, with format and check."""
        told = {name: str(value) for name, value in asdict(self).items()}
        return sealed(METADATA, {"format": str(FORMAT)} | told)

    @classmethod
    def of(cls, items: Mapping[str, str]) -> Self:
        """Return the facts in a metadata record; ProtocolError if one is missing or no number."""
        try:
            return cls(
                **{
                    field.name: field.type(items[field.name])  # type: ignore[operator]
                    for field in fields(cls)
                    if field.default is MISSING or field.name in items
                }
            )
        except KeyError as error:
            raise ProtocolError(f"metadata {METADATA!r} lack {error}") from None
        except ValueError as error:
            raise ProtocolError(f"metadata {METADATA!r}: {error}") from None


def sealed(name: str, items: Mapping[str, str]) -> dict[str, str]:
    """Return the items of a metadata record with their check."""
    return {**items, _CHECK: _check(name, items)}


def is_sealed(name: str, items: Mapping[str, str]) -> bool:
    """Whether the check in a metadata record is right; False without one."""
    return items.get(_CHECK) == _check(name, items)


def needs_seal(name: str, items: Mapping[str, str]) -> bool:
    """Whether a metadata record is one of ours, or says so."""
    return name.startswith(METADATA) or _CHECK in items


def _check(name: str, items: Mapping[str, str]) -> str:
    told = [name, *(f"{key}={items[key]}" for key in sorted(items) if key != _CHECK)]
    return f"{crc32(chr(0).join(told).encode()):08x}"
