"""A setup by its name, or a user's own from TOML; docs/setups.md has an annotated file. A shell.

A mistake in the file is a ConfigError that names the field and the fix.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from kontur_av.codecs.coding import PREFERENCES
from kontur_av.errors import ConfigError, one_of, refused
from kontur_av.media import VIDEO_CODECS, parse_size
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.setup.setup_text import setup_toml
from pipelines.session.setup.table import NO_RADIO, RtcLeg, Setup, VideoStream, VoiceStream
from telepresence.haptics.envelope import SafetyLimits
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.radio.profile import BUILT_IN as RADIOS
from telepresence.link.radio.profile import started
from telepresence.link.radio.profile_file import load_radio
from telepresence.toml_file import parse_toml, read_toml, typed

#: The humanoid SpaceJustin, with voice both ways and a picture for the ground.
SPACEJUSTIN = Setup(
    name="spacejustin",
    cameras=("stereo", "static", "head"),
    uplink_video=VideoStream(name="uplink_video", cap_bps=85_000),
    uplink_voice=VoiceStream(name="uplink_voice", cap_bps=8_000),
    downlink_video=VideoStream(name="downlink_video", cap_bps=512_000),
    downlink_voice=VoiceStream(name="downlink_voice", cap_bps=64_000),
)
#: The two-joint robot at its task board: more picture, no voice.
TASKBOARD = Setup(
    name="taskboard",
    cameras=("stereo", "static"),
    uplink_video=VideoStream(name="uplink_video", cap_bps=90_000),
)
BUILT_IN = {setup.name: setup for setup in (SPACEJUSTIN, TASKBOARD)}


_NOTHING: Mapping[str, Any] = {}


@dataclass(frozen=True, kw_only=True)
class _Video:
    cap_kbps: float
    size: str = "640x480"
    coded: str = "auto"
    codec: str = "h264"
    fps: int = 30
    prefer: str = "quality"
    stale_after_ms: float | None = None


@dataclass(frozen=True, kw_only=True)
class _Voice:
    cap_kbps: float
    stale_after_ms: float | None = None


@dataclass(frozen=True, kw_only=True)
class _Rtc:
    video_kbps: float = RtcLeg.video_bps / 1000
    voice_kbps: float = RtcLeg.voice_bps / 1000
    taken_kbps: float = RtcLeg.taken_bps / 1000


@dataclass(frozen=True, kw_only=True)
class _Link:
    frame_octets: int | None = None


@dataclass(frozen=True, kw_only=True)
class _File:
    """The fields of a setup file; their names are those of `Setup`."""

    name: str
    uplink_video: _Video
    cameras: tuple[str, ...] = field(
        metadata={"like": 'a list of names, like ["stereo", "static"]'}
    )
    uplink_voice: _Voice | None = None
    downlink_video: _Video | None = None
    downlink_voice: _Voice | None = None
    sources: Mapping[str, str] = field(
        default_factory=dict, metadata={"like": 'a table of texts, like left = "v4l2:/dev/video0"'}
    )
    uplink: _Link = _Link()
    downlink: _Link = _Link()
    radio: str = NO_RADIO
    radio_delay_ms: float = 0.0
    deadband: str = "off"
    hand: str = "direct"
    axes: int = 2
    gripper: bool = False
    rtc: _Rtc | None = None
    partner_arm: str = "none"
    tasks: bool = False
    safety: SafetyLimits = field(default_factory=SafetyLimits)
    recorded_cameras: str = "idle"
    region: str = "off"
    region_points: Mapping[str, tuple[tuple[float, float], ...]] = field(
        default_factory=dict,
        metadata={"like": "a table of points, like wrist = [[x, y], [x, y], [x, y], [x, y]]"},
    )
    base_port: int = 27_000


def load_setup(
    name: str,
    *,
    sources: Mapping[str, str] = _NOTHING,
    changes: Mapping[str, Any] = _NOTHING,
    radio_start_s: float | None = None,
) -> Setup:
    """A built-in setup by its name, or a user's own from a TOML file; ConfigError otherwise.

    sources: the source of each input named; it replaces the setup's own. changes: other fields of
    `Setup` to replace. radio_start_s: begin the session this long after the acquisition of signal
    of the radio's pass.
    """
    return _built(_values_of(name), sources, changes, radio_start_s)


def setup_from_text(
    text: str, *, changes: Mapping[str, Any] = _NOTHING, radio_start_s: float | None = None
) -> Setup:
    """A setup from the text of a TOML file, as `setup_text.setup_toml` writes it.

    changes, radio_start_s: as of `load_setup`. Raises ConfigError for a text that is not a setup.
    """
    return setup_from_table(
        parse_toml(text, "its setup"), changes=changes, radio_start_s=radio_start_s
    )


def _built(
    found: Mapping[str, Any],
    sources: Mapping[str, str],
    changes: Mapping[str, Any],
    radio_start_s: float | None,
) -> Setup:
    # Put them in before the setup is built: an input may have its only source on the command line.
    own = {current(name, INPUTS): spec for name, spec in found["sources"].items()}
    values = {**found, "sources": {**own, **sources}, **changes}
    radio = values["radio"]
    if isinstance(radio, str) and (radio_start_s is not None or radio not in RADIOS):
        values["radio"] = radio = load_radio(radio)
    if radio_start_s is not None:
        values["radio"] = started(radio, radio_start_s)
    return Setup(**values)


def _values_of(name: str) -> dict[str, Any]:
    if name in BUILT_IN:
        return {each.name: getattr(BUILT_IN[name], each.name) for each in fields(Setup)}
    table = _table_of(name)
    with refused(f"setup {name}", ConfigError):
        return _values(table)


def _table_of(name: str) -> Mapping[str, Any]:
    path = Path(name)
    if path.suffix != ".toml":
        raise ConfigError(
            f"unknown setup {name}: take {' or '.join(sorted(BUILT_IN))}, or a file NAME.toml"
        )
    return {"name": path.stem, **read_toml(path, "setup")}


def setup_from_table(
    table: Mapping[str, Any],
    *,
    changes: Mapping[str, Any] = _NOTHING,
    radio_start_s: float | None = None,
) -> Setup:
    """A setup from the table that a TOML file holds; changes, radio_start_s: as of `load_setup`."""
    return _built(_values(table), _NOTHING, changes, radio_start_s)


def setup_table(name: str) -> Mapping[str, Any]:
    """The table that the TOML file of a setup holds, also of one that is built in; ConfigError."""
    if name in BUILT_IN:
        return parse_toml(setup_toml(BUILT_IN[name]), name)
    return _table_of(name)


def _values(table: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of `Setup`; the radio is still a name."""
    entry = typed(table, _File, "a setup")
    values = {each.name: getattr(entry, each.name) for each in fields(entry)}
    for name in ("uplink_video", "downlink_video"):
        if values[name] is not None:
            values[name] = _video(name, values[name])
    for name in ("uplink_voice", "downlink_voice"):
        voice = values[name]
        if voice is not None:
            cap_bps = round(voice.cap_kbps * 1000)
            values[name] = VoiceStream(
                name=name, cap_bps=cap_bps, stale_after_ms=voice.stale_after_ms
            )
    if entry.rtc is not None:
        values["rtc"] = RtcLeg(
            video_bps=round(entry.rtc.video_kbps * 1000),
            voice_bps=round(entry.rtc.voice_kbps * 1000),
            taken_bps=round(entry.rtc.taken_kbps * 1000),
        )
    for name, profile in (("uplink", UPLINK), ("downlink", DOWNLINK)):
        values[name] = _profile(profile, values[name].frame_octets)
    return values


def _profile(profile: LinkProfile, frame_octets: int | None) -> LinkProfile:
    octets = profile.frame_octets if frame_octets is None else frame_octets
    # A longer frame has room for the standard's own pointer, and needs it.
    short = profile.pointer_in_vcid and octets <= profile.frame_octets
    return replace(profile, frame_octets=octets, pointer_in_vcid=short)


def _video(name: str, entry: _Video) -> VideoStream:
    width, height = parse_size(entry.size, f"{name}.size")
    coded = None if entry.coded == "auto" else parse_size(entry.coded, f"{name}.coded")
    return VideoStream(
        name=name,
        cap_bps=round(entry.cap_kbps * 1000),
        width=width,
        height=height,
        fps=entry.fps,
        prefer=one_of(entry.prefer, PREFERENCES, f"{name}: prefer"),
        coded=coded,
        codec=one_of(entry.codec, VIDEO_CODECS, f"{name}: codec"),
        stale_after_ms=entry.stale_after_ms,
    )
