"""The list of `kontur-av devices`, from a simulated /dev and /proc/asound."""

import errno
import struct
from itertools import product
from pathlib import Path

from kontur_av.sources.v4l2 import CameraMode, cameras
from pipelines.commands.devices import devices
from pipelines.media.input_devices import microphones

PCM = """\
00-00: ALC257 Analog : ALC257 Analog : playback 1 : capture 1
00-03: HDMI 0 : HDMI 0 : playback 1
01-00: USB Audio : USB Audio : capture 1
"""
SCENES = {"left": "scene:left", "ground_mic": "scene:ground_voice"}


FORMATS = [b"MJPG", b"YUYV"]
#: One size, and a range up to another.
SIZES = [struct.pack("=3I", 1, 640, 480), struct.pack("=7I", 3, 16, 1920, 2, 16, 1080, 2)]
RATES = [struct.pack("=3I", 1, 1, 30), struct.pack("=3I", 1, 2, 15)]


def driver(capabilities: dict[str, tuple[int, int]]):
    """The ioctl of a V4L2 driver; capabilities: node's text -> (whole, own)."""

    def ioctl(descriptor: int, request: int, buffer: bytearray) -> int:
        node = Path(f"/proc/self/fd/{descriptor}").resolve().read_text()
        if request == 0x80685600:
            whole, own = capabilities[node]
            buffer[16:48] = b"Good Camera".ljust(32, b"\0")
            buffer[84:92] = whole.to_bytes(4, "little") + own.to_bytes(4, "little")
            return 0
        values = {0xC0405602: FORMATS, 0xC02C564A: SIZES, 0xC034564B: RATES}[request]
        (index,) = struct.unpack_from("=I", buffer)
        if index >= len(values):
            raise OSError(errno.EINVAL, "Invalid argument")
        at = {0xC0405602: 44, 0xC02C564A: 8, 0xC034564B: 16}[request]
        assert request == 0xC0405602 or buffer[4:8] in FORMATS
        buffer[at : at + len(values[index])] = values[index]
        return 0

    return ioctl


def listed(place):
    lines: list[str] = []
    assert devices(lines.append, dev=place, asound=place, scenes=SCENES) == 0
    return lines


def test_without_devices_the_other_sources_are_named_and_a_bad_node_with_its_reason(tmp_path):
    first, *others = listed(tmp_path)
    assert first == "no camera and no microphone here; scene:NAME, a media file and pipe:PATH work"
    assert any("scene:ground_voice" in line and "ground_mic" in line for line in others)
    (tmp_path / "video0").write_text("")
    first, *_ = listed(tmp_path)
    assert f"v4l2:{tmp_path / 'video0'}" in first and "is no V4L2 device" in first


def test_cameras_are_listed_with_formats_and_only_capture_lines_are_microphones(
    tmp_path, monkeypatch
):
    nodes = {"video10": "old", "video0": "own", "video1": "meta", "videoish": ""}
    for name, content in nodes.items():
        (tmp_path / name).write_text(content)
    known = {"own": (0x84A00001, 0x04200001), "meta": (0x84A00001, 0x04A00000), "old": (1, 0)}
    found = cameras(tmp_path, driver(known))
    sizes = ((640, 480), (1920, 1080))
    modes = tuple(
        CameraMode(name, *size, fps)
        for name, size, fps in product(("MJPG", "YUYV"), sizes, (30.0, 7.5))
    )
    assert [(Path(c.path).name, c.card, c.modes) for c in found] == [
        (name, "Good Camera", modes) for name in ("video0", "video10")
    ]
    monkeypatch.setattr("kontur_av.sources.v4l2.cameras.__defaults__", (driver(known),))
    assert listed(tmp_path)[1:3] == [
        f"            {format_} 640x480@30 1920x1080@30" for format_ in ("MJPG", "YUYV")
    ]
    (tmp_path / "pcm").write_text(PCM)
    assert [(m.device, m.name) for m in microphones(tmp_path)] == [
        ("plughw:0,0", "ALC257 Analog"),
        ("plughw:1,0", "USB Audio"),
    ]
