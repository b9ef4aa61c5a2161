"""A user's own setup: a TOML file with the fields of `Setup`; docs/setups.md has an annotated one.

What the file gets wrong is a ConfigError that names the field and the mend.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from pipelines.setup.built_in import BUILT_IN
from pipelines.setup.table import Setup, VideoStream, VoiceStream
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile

_NUMBER = (int, float)
_VOICE_KINDS: Mapping[str, Any] = {"cap_kbps": _NUMBER, "stale_after_ms": _NUMBER}
_VIDEO_KINDS: Mapping[str, Any] = {**_VOICE_KINDS, "size": str, "coded": str, "fps": int}


def load_setup(name: str) -> Setup:
    """A built-in setup by its name, or a user's own from a TOML file; ConfigError otherwise."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    path = Path(name)
    if path.suffix != ".toml":
        raise ConfigError(
            f"unknown setup {name}: take {' or '.join(sorted(BUILT_IN))}, or a file NAME.toml"
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read setup {name}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"setup {name} is not TOML: {error}") from None
    return setup_from_table({"name": path.stem, **table})


def setup_from_table(table: Mapping[str, Any]) -> Setup:
    """A setup from the table that a TOML file holds."""
    known = {entry.name for entry in fields(Setup)}
    values = dict(table)
    for name in values:
        if name not in known:
            raise ConfigError(f"unknown field {name}: a setup has {', '.join(sorted(known))}")
    for name in ("uplink_video", "downlink_video"):
        if name in values:
            values[name] = _video(name, values[name])
    for name in ("uplink_voice", "downlink_voice"):
        if name in values:
            entries = _checked(name, values[name], _VOICE_KINDS)
            values[name] = VoiceStream(
                name=name,
                cap_bps=_cap_bps(name, entries),
                stale_after_ms=entries.get("stale_after_ms"),
            )
    for name, profile in (("uplink", UPLINK), ("downlink", DOWNLINK)):
        if name in values:
            values[name] = _profile(profile, values[name])
    if "uplink_video" not in values or "cameras" not in values:
        raise ConfigError("a setup needs at least the fields uplink_video and cameras")
    if not _is_strings(values["cameras"]):
        raise ConfigError('cameras must be a list of names, like ["stereo", "static"]')
    values["cameras"] = tuple(values["cameras"])
    sources = values.get("sources", {})
    if not isinstance(sources, Mapping) or not _is_strings(list(sources.values())):
        raise ConfigError('sources must be a table of strings, like left = "v4l2:/dev/video0"')
    kinds: dict[str, Any] = {
        "name": str,
        "radio": str,
        "deadband": str,
        "radio_delay_ms": (int, float),
        "base_port": int,
    }
    for name, kind in kinds.items():
        value = values.get(name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, kind)):
            raise ConfigError(f"{name} must be a {'text' if kind is str else 'number'}")
    return Setup(**values)


def _profile(profile: LinkProfile, table: object) -> LinkProfile:
    entries = _checked(profile.name, table, {"frame_octets": int})
    octets = entries.get("frame_octets", profile.frame_octets)
    # A longer frame has room for the standard's own pointer, and needs it.
    short = profile.pointer_in_signaling and octets <= profile.frame_octets
    return replace(profile, frame_octets=octets, pointer_in_signaling=short)


def _video(name: str, table: object) -> VideoStream:
    entries = _checked(name, table, _VIDEO_KINDS)
    options: dict[str, Any] = {"stale_after_ms": entries.get("stale_after_ms")}
    if "size" in entries:
        options["width"], options["height"] = parse_size(entries["size"], f"{name}.size")
    if entries.get("coded", "auto") != "auto":
        options["coded"] = parse_size(entries["coded"], f"{name}.coded")
    if "fps" in entries:
        options["fps"] = entries["fps"]
    return VideoStream(name=name, cap_bps=_cap_bps(name, entries), **options)


def _cap_bps(name: str, entries: Mapping[str, Any]) -> int:
    if "cap_kbps" not in entries:
        raise ConfigError(f"{name} needs cap_kbps")
    cap_kbps: float = entries["cap_kbps"]
    return round(cap_kbps * 1000)


def _checked(name: str, table: object, kinds: Mapping[str, Any]) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise ConfigError(f"{name} must be a table [{name}] with {', '.join(kinds)}")
    for key, value in table.items():
        if key not in kinds:
            raise ConfigError(f"unknown field {name}.{key}: it has {', '.join(kinds)}")
        if isinstance(value, bool) or not isinstance(value, kinds[key]):
            raise ConfigError(f"{name}.{key} must be a {'text' if kinds[key] is str else 'number'}")
        if isinstance(value, float) and not isfinite(value):
            raise ConfigError(f"{name}.{key} is {value}: it must be a finite number")
    return dict(table)


def _is_strings(values: object) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
