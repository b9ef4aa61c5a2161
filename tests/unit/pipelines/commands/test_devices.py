"""The list of `kontur-av devices`, from a simulated /dev and /proc/asound."""

import errno
from pathlib import Path

from pipelines.commands.devices import devices
from pipelines.media.input_devices import cameras, microphones

PCM = """\
00-00: ALC257 Analog : ALC257 Analog : playback 1 : capture 1
00-03: HDMI 0 : HDMI 0 : playback 1
01-00: USB Audio : USB Audio : capture 1
"""
SCENES = {"left": "scene:left", "ground_mic": "scene:ground_voice"}


def driver(capabilities: dict[str, tuple[int, int]], formats: list[bytes]):
    """The ioctl of a V4L2 driver; capabilities: node's text -> (whole, own)."""

    def ioctl(descriptor: int, request: int, buffer: bytearray) -> int:
        node = Path(f"/proc/self/fd/{descriptor}").resolve().read_text()
        if request == 0x80685600:
            whole, own = capabilities[node]
            buffer[16:48] = b"Good Camera".ljust(32, b"\0")
            buffer[84:92] = whole.to_bytes(4, "little") + own.to_bytes(4, "little")
            return 0
        assert request == 0xC0405602
        index = int.from_bytes(buffer[0:4], "little")
        if index >= len(formats):
            raise OSError(errno.EINVAL, "Invalid argument")
        buffer[44:48] = formats[index]
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


def test_cameras_are_listed_with_formats_and_only_capture_lines_are_microphones(tmp_path):
    nodes = {"video10": "old", "video0": "own", "video1": "meta", "videoish": ""}
    for name, content in nodes.items():
        (tmp_path / name).write_text(content)
    known = {"own": (0x84A00001, 0x04200001), "meta": (0x84A00001, 0x04A00000), "old": (1, 0)}
    found = cameras(tmp_path, driver(known, [b"MJPG", b"YUYV"]))
    assert [(Path(c.path).name, c.card, c.formats) for c in found] == [
        (name, "Good Camera", ("MJPG", "YUYV")) for name in ("video0", "video10")
    ]
    (tmp_path / "pcm").write_text(PCM)
    assert [(m.device, m.name) for m in microphones(tmp_path)] == [
        ("plughw:0,0", "ALC257 Analog"),
        ("plughw:1,0", "USB Audio"),
    ]
