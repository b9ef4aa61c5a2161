"""What a session's inputs need here: sources that can be opened, and room for their pictures."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError, refused
from kontur_av.sources import check_spec
from kontur_av.sources.source import PAGE
from pipelines.session.machine_checks import (
    NEEDED_SHM_OCTETS,
    check_descriptors,
    check_shared_memory,
    take_descriptors,
)
from pipelines.session.setup.table import Setup, VideoStream
from telepresence.world import audio_scenes, video_scenes


def check_sources(setup: Setup, inputs: Sequence[str], *, pages: bool = True) -> None:
    """ConfigError for the first source that cannot be opened, before anything has started.

    inputs: those that are captured here. pages: whether a page can give an input's pictures.
    """
    scenes: dict[str, Iterable[str]] = {"video": video_scenes(), "audio": audio_scenes()}
    _check_shared(setup, inputs)
    for name in inputs:
        kind = setup.kind_of(name)
        with refused(f"input {name}", ConfigError):
            check_spec(setup.source(name), kind, scenes[kind])
    for name in inputs:
        if setup.source(name) == PAGE and not pages:
            raise ConfigError(
                f"input {name}: source {PAGE} needs the pages: leave --no-page out, "
                "or give it another source"
            )


def _check_shared(setup: Setup, inputs: Sequence[str]) -> None:
    # A camera serves one program only, and two readers of one FIFO each get torn pictures.
    taken: dict[Path, str] = {}
    for name in inputs:
        family, _, place = setup.source(name).partition(":")
        if family not in ("v4l2", "pipe"):
            continue
        other = taken.setdefault(Path(place).resolve(), name)
        if other != name:
            raise ConfigError(
                f"input {name}: {family}:{place} is that of input {other}: give each its own"
            )


def check_room(setup: Setup, inputs: Sequence[str], *, pages: bool = False) -> None:
    """ConfigError when shared memory has no room for the session's pictures.

    Measured: a topic of pictures holds two or three. Five leave room for the successor of a killed
    process. inputs: those that are captured here. pages: a page joins with decoded pictures, and
    gives its own for a camera.
    """
    cameras = [setup.stream_of(name) for name in inputs if setup.kind_of(name) == "video"]
    # Composed pictures have the uplink's size. Received ones count twice: they are also shown.
    relays = [setup.uplink_video for one in setup.cameras if setup.composition(one) is not None]
    received = [stream for stream in setup.streams if isinstance(stream, VideoStream)]
    streams = [*cameras, *relays, *received * (4 if pages else 2)]
    pictures = sum(stream.width * stream.height * 3 // 2 for stream in streams)
    needed = max(NEEDED_SHM_OCTETS, NEEDED_SHM_OCTETS // 2 + 5 * pictures)
    take_descriptors()
    for verdict in (check_descriptors(), check_shared_memory(needed_octets=needed)):
        if verdict.state == "missing":
            raise ConfigError(f"{verdict.found}: {verdict.fix}")


def draw_backgrounds(setup: Setup, inputs: Sequence[str], clock: MonotonicClock) -> None:
    """Draw what the built-in scenes share before the fork, so that no camera draws it again.

    inputs: those that are captured here.
    """
    pictures, sounds = video_scenes(), audio_scenes()
    for name in inputs:
        kind, _, scene = setup.source(name).partition(":")
        if kind != "scene":
            continue
        if setup.kind_of(name) == "audio":
            sounds[scene](name, clock).close()
        else:
            stream = setup.stream_of(name)
            source = pictures[scene](name, stream.width, stream.height, stream.fps, clock)
            source.close()
