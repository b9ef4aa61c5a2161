"""A setup as the text of a TOML file, with every field. A core."""

from collections.abc import Iterator
from dataclasses import fields

from pipelines.session.setup.table import Setup, VideoStream, VoiceStream


def setup_toml(setup: Setup) -> str:
    """Return a text that `setup_file` reads as this setup.

    A radio profile that is not built in is there by its name only, with its fields as a comment.
    """
    return "\n".join([*_plain(setup), *_tables(setup), ""])


def _plain(setup: Setup) -> Iterator[str]:
    radio = setup.radio_profile
    yield f"# radio: {radio!r}".replace("\n", " ")
    for each in fields(Setup):
        value = getattr(setup, each.name)
        if each.name == "radio":
            value = value if isinstance(value, str) else radio.name
        if isinstance(value, str | bool | int | float | tuple):
            yield f"{each.name} = {_toml(value)}"


def _tables(setup: Setup) -> Iterator[str]:
    for stream in setup.streams:
        yield f"\n[{stream.name}]"
        yield from _video(stream) if isinstance(stream, VideoStream) else _voice(stream)
    if setup.rtc is not None:
        yield "\n[rtc]"
        for name in ("video", "voice", "taken"):
            yield f"{name}_kbps = {getattr(setup.rtc, f'{name}_bps') / 1000!r}"
    for name in ("uplink", "downlink"):
        yield f"\n[{name}]\nframe_octets = {getattr(setup, name).frame_octets}"
    yield "\n[safety]"
    for each in fields(setup.safety):
        yield f"{each.name} = {float(getattr(setup.safety, each.name))!r}"
    if setup.region_points:
        yield "\n[region_points]"
        for camera, points in setup.region_points.items():
            yield f"{_text(camera)} = {[[float(x), float(y)] for x, y in points]}"
    if setup.inputs:
        yield "\n[sources]"
        for name in setup.inputs:
            yield f"{name} = {_text(setup.source(name))}"


def _video(stream: VideoStream) -> Iterator[str]:
    yield from _voice(stream)
    yield f'size = "{stream.width}x{stream.height}"'
    if stream.coded is not None:
        yield f'coded = "{stream.coded[0]}x{stream.coded[1]}"'
    yield f'codec = "{stream.codec}"'
    yield f"fps = {stream.fps}"
    yield f"prefer = {_text(stream.prefer)}"


def _voice(stream: VideoStream | VoiceStream) -> Iterator[str]:
    yield f"cap_kbps = {stream.cap_bps / 1000!r}"
    if stream.stale_after_ms is not None:
        yield f"stale_after_ms = {float(stream.stale_after_ms)!r}"


def _toml(value: str | float | tuple[str, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return _text(value) if isinstance(value, str) else repr(value)


def _text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
