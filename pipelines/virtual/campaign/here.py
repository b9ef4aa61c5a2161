"""What decides the figures of a run besides its task: the program's text and its libraries."""

import platform
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("kontur_av", "telepresence", "pipelines")
#: Libraries whose versions may change a figure.
_LIBRARIES = ("numpy", "av", "opencv-python-headless", "opuslib", "sgp4")


@cache
def code_digest(packages: tuple[str, ...] = PACKAGES) -> str:
    """A digest of the text of all modules, and of the tables beside them."""
    digest = sha256()
    for package in packages:
        for path in sorted((_ROOT / package).rglob("*")):
            if path.suffix in (".py", ".toml"):
                digest.update(f"{path.relative_to(_ROOT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def facts() -> Mapping[str, str]:
    """Name and version of each part that two machines must have alike."""
    return {
        "kontur-av": code_digest(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _version(name) for name in _LIBRARIES},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
