"""What cameras offer: their formats, sizes and rates by Video4Linux2, and which to ask for."""

import fcntl
import os
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

# linux/videodev2.h: VIDIOC_QUERYCAP and VIDIOC_ENUM_*, with their structures.
_VIDIOC_QUERYCAP = 0x80685600
_VIDIOC_ENUM_FMT = 0xC0405602
_VIDIOC_ENUM_FRAMESIZES = 0xC02C564A
_VIDIOC_ENUM_FRAMEINTERVALS = 0xC034564B
_CAPABILITY = struct.Struct("=16s32s32sIII12x")
_FORMAT = struct.Struct("=III32s4sI12x")
_SIZE = struct.Struct("=I4sI6I8x")
_INTERVAL = struct.Struct("=I4sIII6I8x")
_CAP_DEVICE_CAPS = 0x80000000
_CAP_CAPTURE = 0x00000001
_CAP_CAPTURE_MPLANE = 0x00001000
_BUF_CAPTURE = 1
_BUF_CAPTURE_MPLANE = 9
_DISCRETE = 1
#: What can be asked for: FFmpeg's names, the cheapest to decode first.
FORMATS = {
    "YU12": "yuv420p",
    "NV12": "nv12",
    "YUYV": "yuyv422",
    "UYVY": "uyvy422",
    "MJPG": "mjpeg",
    "JPEG": "mjpeg",
}

Ioctl = Callable[[int, int, bytearray], object]


class CameraMode(NamedTuple):
    """A FourCC, such as "MJPG", a size in pixels, and pictures a second."""

    fourcc: str
    width: int
    height: int
    fps: float


@dataclass(frozen=True, slots=True)
class CameraDevice:
    """A V4L2 capture device. problem: why it cannot be opened."""

    path: str
    card: str
    modes: tuple[CameraMode, ...]
    problem: str = ""


def choose_mode(modes: Iterable[CameraMode], wanted: CameraMode) -> CameraMode | None:
    """Return the mode that gives most of the wanted pixels a second; None without any. A core.

    Among equals, the smallest picture, the format that is decoded most cheaply, the lowest rate.
    wanted: its FourCC is not looked at.
    """
    cost = list(FORMATS).index

    def rank(mode: CameraMode) -> tuple[float, ...]:
        pixels = min(mode.width, wanted.width) * min(mode.height, wanted.height)
        # A driver need not tell its rates.
        useful = pixels * min(mode.fps or wanted.fps, wanted.fps)
        return -useful, mode.width * mode.height, cost(mode.fourcc), mode.fps

    return min((mode for mode in modes if mode.fourcc in FORMATS), key=rank, default=None)


def cameras(dev: Path, ioctl: Ioctl = fcntl.ioctl) -> Sequence[CameraDevice]:
    """The V4L2 devices in `dev` that capture pictures, by number."""
    nodes = [node for node in dev.glob("video*") if re.fullmatch(r"video\d+", node.name)]
    asked = (ask_camera(node, ioctl) for node in sorted(nodes, key=lambda one: int(one.name[5:])))
    return [camera for camera in asked if camera is not None]


def ask_camera(node: Path, ioctl: Ioctl = fcntl.ioctl) -> CameraDevice | None:
    """Ask a device what it offers; None if it does not capture."""
    try:
        descriptor = os.open(node, os.O_RDWR | os.O_NONBLOCK)
    except PermissionError:
        problem = "not permitted: add yourself to the group video and log in again"
        return CameraDevice(str(node), "", (), problem)
    except OSError as error:
        return CameraDevice(str(node), "", (), f"cannot be opened: {error.strerror}")
    try:
        buffer = bytearray(_CAPABILITY.size)
        ioctl(descriptor, _VIDIOC_QUERYCAP, buffer)
        _, card, _, _, whole, own = _CAPABILITY.unpack(buffer)
        # A camera has several nodes. The node's own capabilities tell which one captures.
        capabilities = own if whole & _CAP_DEVICE_CAPS else whole
        if capabilities & _CAP_CAPTURE:
            kind = _BUF_CAPTURE
        elif capabilities & _CAP_CAPTURE_MPLANE:
            kind = _BUF_CAPTURE_MPLANE
        else:
            return None

        def listed(request: int, form: struct.Struct, *asked: object) -> Iterator[tuple[Any, ...]]:
            for index in range(256):
                buffer = bytearray(form.size)
                form.pack_into(buffer, 0, index, *asked)
                try:
                    ioctl(descriptor, request, buffer)
                except OSError:
                    # EINVAL ends the list.
                    return
                yield form.unpack(buffer)

        modes = tuple(_modes(kind, listed))
        return CameraDevice(str(node), _text(card), modes)
    except OSError as error:
        return CameraDevice(str(node), "", (), f"is no V4L2 device: {error.strerror}")
    finally:
        os.close(descriptor)


def _modes(kind: int, listed: Callable[..., Iterator[tuple[Any, ...]]]) -> Iterator[CameraMode]:
    """Each mode of the device; of a range of sizes or rates, the largest."""
    for _, _, _, _, fourcc, _ in listed(_VIDIOC_ENUM_FMT, _FORMAT, kind, 0, b"", b"", 0):
        for size in listed(_VIDIOC_ENUM_FRAMESIZES, _SIZE, fourcc, *[0] * 7):
            width, height = size[3:5] if size[2] == _DISCRETE else (size[4], size[7])
            asked = (fourcc, width, height, *[0] * 7)
            rates = listed(_VIDIOC_ENUM_FRAMEINTERVALS, _INTERVAL, *asked)
            # Of a range, the shortest interval stands first, too.
            fps = [each[6] / each[5] for each in rates if each[5]] or [0.0]
            yield from (CameraMode(_text(fourcc), width, height, rate) for rate in fps)


def _text(octets: bytes) -> str:
    return octets.split(b"\0")[0].decode("utf-8", "replace").strip()
