"""Libraries that PyAV's wheel carries, which a fresh machine often does not have otherwise."""

import importlib.util
from pathlib import Path

#: Folders of a wheel's libraries, relative to the `av` package: auditwheel and delvewheel put them
#: beside it, delocate inside it.
_PLACES = (("../av.libs", "so*"), (".dylibs", "dylib"), ("../av.libs", "dll"))


def carried_by_pyav(name: str) -> Path | None:
    """Return a library, such as `opus`; None if PyAV was built against the system's FFmpeg."""
    spec = importlib.util.find_spec("av")
    if spec is None or spec.origin is None:
        return None
    package = Path(spec.origin).parent
    for folder, suffix in _PLACES:
        for found in sorted((package / folder).glob(f"*{name}*.{suffix}")):
            return found.resolve()
    return None
