"""Names of files inside a fenced directory."""

from kontur_av.errors import ConfigError

_MOST_OCTETS = 200
_MOST_PARTS = 8


def fenced(name: str, *, directory: bool = False) -> tuple[str, ...]:
    """Return the parts of a name inside the directory.

    directory: it names a directory, so that "" is the fenced one itself. ConfigError for a name
    that could leave the directory, or is hidden: hidden names are those of files half written.
    """
    if directory and name in ("", "."):
        return ()
    parts = tuple(name.split("/"))
    printable = name.isprintable() and len(name.encode(errors="replace")) <= _MOST_OCTETS
    if not printable or len(parts) > _MOST_PARTS or any(part[:1] in ("", ".") for part in parts):
        raise ConfigError(
            f"file name {name[:80]!r}: give at most {_MOST_OCTETS} printable octets and "
            f"{_MOST_PARTS} parts, none empty or with a dot in front"
        )
    return parts
