"""`kontur-av devices`: the inputs of this machine, and the name of each in --source."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from pipelines.media.input_devices import cameras, microphones


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "List cameras (V4L2), microphones (ALSA) and built-in scenes, each as "
        "`kontur-av stream --source NAME=SPEC` takes it."
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
        about = camera.problem or f"{camera.card} ({', '.join(camera.formats) or 'no format'})"
        print(f"camera      v4l2:{camera.path:<24} {about}")
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


def _scenes() -> Mapping[str, str]:
    from telepresence.world import DEFAULT_SCENES

    return DEFAULT_SCENES
