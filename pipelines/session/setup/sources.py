"""Whether the sources of a setup can be opened here."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.sources import check_spec
from pipelines.session.setup.table import Setup
from telepresence.world import audio_scenes, video_scenes


def check_sources(setup: Setup, inputs: Sequence[str]) -> None:
    """ConfigError for the first source that cannot be opened, before anything has started.

    inputs: those that are captured here.
    """
    scenes: dict[str, Iterable[str]] = {"video": video_scenes(), "audio": audio_scenes()}
    _check_shared(setup, inputs)
    for name in inputs:
        kind = setup.kind_of(name)
        try:
            check_spec(setup.source(name), kind, scenes[kind])
        except ConfigError as error:
            raise ConfigError(f"input {name}: {error}") from None


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
