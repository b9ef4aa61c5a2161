"""The cameras (V4L2) and microphones (ALSA) of this machine."""

import fcntl
import os
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

# linux/videodev2.h: VIDIOC_QUERYCAP and VIDIOC_ENUM_FMT, with their structures.
_VIDIOC_QUERYCAP = 0x80685600
_VIDIOC_ENUM_FMT = 0xC0405602
_CAPABILITY = struct.Struct("=16s32s32sIII12x")
_FORMAT = struct.Struct("=III32s4sI12x")
_CAP_DEVICE_CAPS = 0x80000000
_CAP_CAPTURE = 0x00000001
_CAP_CAPTURE_MPLANE = 0x00001000
_BUF_CAPTURE = 1
_BUF_CAPTURE_MPLANE = 9

Ioctl = Callable[[int, int, bytearray], object]


@dataclass(frozen=True, slots=True)
class CameraDevice:
    """A V4L2 capture device. formats: FourCCs such as "MJPG"; problem: why it cannot be opened."""

    path: str
    card: str
    formats: tuple[str, ...]
    problem: str = ""


@dataclass(frozen=True, slots=True)
class MicrophoneDevice:
    """An ALSA capture device. device: its name in alsa-lib, such as "plughw:0,0"."""

    device: str
    name: str


def cameras(dev: Path, ioctl: Ioctl = fcntl.ioctl) -> Sequence[CameraDevice]:
    """The V4L2 devices in `dev` that capture pictures, by number."""
    nodes = [node for node in dev.glob("video*") if re.fullmatch(r"video\d+", node.name)]
    asked = (_ask(node, ioctl) for node in sorted(nodes, key=lambda node: int(node.name[5:])))
    return [camera for camera in asked if camera is not None]


def _ask(node: Path, ioctl: Ioctl) -> CameraDevice | None:
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
        return CameraDevice(str(node), _text(card), tuple(_formats(descriptor, kind, ioctl)))
    except OSError as error:
        return CameraDevice(str(node), "", (), f"is no V4L2 device: {error.strerror}")
    finally:
        os.close(descriptor)


def _formats(descriptor: int, kind: int, ioctl: Ioctl) -> Sequence[str]:
    formats: list[str] = []
    for index in range(64):
        buffer = bytearray(_FORMAT.pack(index, kind, 0, b"", b"", 0))
        try:
            ioctl(descriptor, _VIDIOC_ENUM_FMT, buffer)
        except OSError:
            # EINVAL ends the list.
            break
        formats.append(_text(_FORMAT.unpack(buffer)[4]))
    return formats


def _text(octets: bytes) -> str:
    return octets.split(b"\0")[0].decode("utf-8", "replace").strip()


def microphones(asound: Path) -> Sequence[MicrophoneDevice]:
    """The capture devices that ALSA's /proc/asound/pcm lists.

    A line reads `00-02: ALC257 Analog : ALC257 Analog : playback 1 : capture 1`.
    """
    try:
        text = (asound / "pcm").read_text("utf-8", "replace")
    except OSError:
        return []
    found = []
    for line in text.splitlines():
        match = re.match(r"(\d+)-(\d+): ([^:]*)(?::.*)?: *capture \d+", line)
        if match:
            card, device = int(match[1]), int(match[2])
            # plughw converts to 48 kHz mono, which the bare hw device may not offer.
            found.append(MicrophoneDevice(f"plughw:{card},{device}", match[3].strip()))
    return found
