"""`kontur-av devices`: the inputs of this machine, and the name of each in --source."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from kontur_av.sources.v4l2 import CameraMode, cameras
from pipelines.media.input_devices import microphones


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "List cameras (V4L2), microphones (ALSA) and built-in scenes, as `stream --source` takes "
        "them."
    )


def run(args: argparse.Namespace) -> int:
    return devices()


def devices(
    print: Callable[[str], None] = print,
    *,
    dev: Path = Path("/dev"),
    asound: Path = Path("/proc/asound"),
    scenes: Mapping[str, str] | None = None,
) -> int:
    """Print cameras, microphones and the built-in scenes (input -> SPEC); always 0."""
    found_cameras, found_microphones = cameras(dev), microphones(asound)
    for camera in found_cameras:
        print(f"camera      v4l2:{camera.path:<24} {camera.problem or camera.card}")
        for line in _formats(camera.modes):
            print(f"            {line}")
    for microphone in found_microphones:
        print(f"microphone  alsa:{microphone.device:<24} {microphone.name}")
    if not found_cameras and not found_microphones:
        print("no camera and no microphone here; scene:NAME, a media file and pipe:PATH work")
    else:
        print("without a device: scene:NAME, a media file, pipe:PATH (YUV4MPEG2 from a FIFO)")
    for name, spec in (_scenes() if scenes is None else scenes).items():
        print(f"built in    {spec:<29} the default of {name}")
    print("use: kontur-av stream --source NAME=SPEC, for example --source left=v4l2:/dev/video0")
    return 0


def _formats(modes: Iterable[CameraMode]) -> Iterator[str]:
    """A line for each format: its sizes with the highest rate of each."""
    formats: dict[str, dict[str, float]] = {}
    for mode in modes:
        sizes = formats.setdefault(mode.fourcc, {})
        size = f"{mode.width}x{mode.height}"
        sizes[size] = max(mode.fps, sizes.get(size, 0))
    for fourcc, sizes in formats.items():
        yield " ".join((fourcc, *(f"{size}@{fps:.3g}" for size, fps in sizes.items())))


def _scenes() -> Mapping[str, str]:
    from telepresence.world import DEFAULT_SCENES

    return DEFAULT_SCENES
