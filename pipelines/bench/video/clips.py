"""Clips of `bench video`: the built-in scene, and files.

Each picture of a clip is shown once, `fps` a second, whatever the rate of the file. After the last
picture the clip runs backwards, then forwards again: that adds no cut.
"""

import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import I420, empty_picture, planes
from kontur_av.sources.stereo import SeamFinder, merge
from telepresence.world import render, scripted_state

SCENE = "scene"
_SWITCH_S = 5
_CAMERAS = ("stereo", "static", "head")


@dataclass(frozen=True, slots=True)
class Clip:
    """Pictures in memory that child processes share, and the order in which they are shown.

    pictures: shape (count, height * 3 // 2, width), uint8: each an `I420`.
    order: the index of the picture for each number.
    tuned_on: whether settings of the encoder were chosen on it.
    """

    name: str
    pictures: NDArray[np.uint8]
    order: NDArray[np.intp]
    tuned_on: bool

    def luma(self, number: int) -> NDArray[np.uint8]:
        """The luma plane of that number, without the number drawn into it."""
        height = self.pictures.shape[1] * 2 // 3
        plane: NDArray[np.uint8] = self.pictures[self.order[number], :height]
        return plane


def led_in(clip: Clip, count: int) -> Clip:
    """The clip with `count` pictures before it: its own, backwards, so that there is no cut."""
    order = clip.order
    lead = np.resize(np.concatenate((order, order[::-1])), count)[::-1]
    return replace(clip, order=np.concatenate((lead, order)))


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


def mirrored(pictures: int, count: int) -> NDArray[np.intp]:
    """Indices from 0 to pictures - 1 and back, over and over, `count` of them."""
    if pictures == 1:
        return np.zeros(count, np.intp)
    there = np.arange(pictures)
    return np.resize(np.concatenate((there, there[-2:0:-1])), count).astype(np.intp)


def film(
    path: Path, name: str, width: int, height: int, count: int, *, tuned_on: bool = False
) -> Clip:
    """`count` pictures of a media file, or of PGM pictures one after the other in a `.pgm` file.

    Pictures as large as width x height or larger are cropped in the middle and not scaled, unless
    `tuned_on`: those are cropped to the shape and scaled, as they were when settings were tuned.
    Smaller ones are cropped to the shape and enlarged. Raises ConfigError if it cannot be read.
    """
    form = "pgm_pipe" if path.suffix == ".pgm" else None
    try:
        with av.open(str(path), format=form) as container:
            found = [
                _fitted(frame, width, height, scaled=tuned_on)
                for frame, _ in zip(_frames(container), range(count), strict=False)
            ]
    except (av.FFmpegError, OSError, ValueError) as error:
        raise ConfigError(f"clip {str(path)!r} cannot be read: {error}") from None
    if not found:
        raise ConfigError(f"clip {str(path)!r} has no pictures: give a video file")
    pictures = shared_array(len(found), height * 3 // 2, width)
    for index, picture in enumerate(found):
        pictures[index] = picture
    return Clip(name, pictures, mirrored(len(found), count), tuned_on)


def _frames(container: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    if not container.streams.video:
        raise ValueError("it has no pictures")
    yield from container.decode(video=0)


def crop_size(source: tuple[int, int], size: tuple[int, int], *, scaled: bool) -> tuple[int, int]:
    """Width and height of the part of a picture that is taken, in multiples of 4 if it is scaled.

    source: of the file's pictures. size: of the clip. scaled: take all that fits the shape.
    """
    if not scaled and source[0] >= size[0] and source[1] >= size[1]:
        return size
    (source_width, source_height), (width, height) = source, size
    return (
        min(source_width, source_height * width // height) & ~3,
        min(source_height, source_width * height // width) & ~3,
    )


def _fitted(frame: av.VideoFrame, width: int, height: int, *, scaled: bool) -> I420:
    """The middle of `frame`, where needed scaled plane by plane."""
    even = {"width": frame.width & ~1, "height": frame.height & ~1}
    source: I420 = (
        frame.reformat(**even, format="yuv420p").to_ndarray().astype(np.uint8, copy=False)
    )
    rows, columns = source.shape[0] * 2 // 3, source.shape[1]
    crop_width, crop_height = crop_size((columns, rows), (width, height), scaled=scaled)
    left, top = (columns - crop_width) // 2 & ~1, (rows - crop_height) // 2 & ~1
    into = empty_picture(width, height)
    enlarged = crop_width < width or crop_height < height
    method = cv2.INTER_CUBIC if enlarged else cv2.INTER_AREA
    for index, (plane, target) in enumerate(zip(planes(source), planes(into), strict=True)):
        half = 1 if index else 0
        part = plane[
            top >> half : (top + crop_height) >> half, left >> half : (left + crop_width) >> half
        ]
        if part.shape == target.shape:
            target[:] = part
        else:
            cv2.resize(part, (target.shape[1], target.shape[0]), dst=target, interpolation=method)
    return into


def scene(width: int, height: int, fps: int, count: int) -> Clip:
    """The built-in task board through its cameras, with a camera switch every 5 s."""
    pictures = shared_array(count, height * 3 // 2, width)
    left, right = empty_picture(width, height), empty_picture(width, height)
    finder = SeamFinder()
    for number in range(count):
        state = scripted_state(number * NS_PER_S // fps)
        camera = _CAMERAS[number // (_SWITCH_S * fps) % len(_CAMERAS)]
        if camera == "stereo":
            render("left", state, left, number)
            render("right", state, right, number)
            merge(left, right, pictures[number], finder.handle_pictures(left, right))
        else:
            render(camera, state, pictures[number], number)
    return Clip(SCENE, pictures, np.arange(count), tuned_on=True)
