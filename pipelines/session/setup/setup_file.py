"""A setup by its name, or a user's own from TOML; docs/setup-file.md has every field. A shell.

A mistake in the file is a ConfigError that names the field and the fix.
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError, refused
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.setup.setup_text import SETUP_FILE, setup_table, setup_values
from pipelines.session.setup.table import Setup, VideoStream, VoiceStream
from telepresence.haptics.axes import AXIS_NAMES
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


def load_setup(
    name: str | Mapping[str, Any],
    *,
    sources: Mapping[str, str] = _NOTHING,
    changes: Mapping[str, Any] = _NOTHING,
    radio_start_s: float | None = None,
) -> Setup:
    """A built-in setup by its name, a user's own from a TOML file, or by its table; ConfigError.

    sources: the source of each input named; it replaces the setup's own. changes: other fields of
    `Setup` to replace. radio_start_s: begin the session this long after the acquisition of signal
    of the radio's pass.
    """
    values = dict(_values_of(name))
    # Put them in before the setup is built: an input may have its only source on the command line.
    own = {current(key, INPUTS): spec for key, spec in values["sources"].items()}
    values |= {"sources": {**own, **sources}, **changes}
    radio = values["radio"]
    if isinstance(radio, str) and (radio_start_s is not None or radio not in RADIOS):
        values["radio"] = radio = load_radio(radio)
    if radio_start_s is not None:
        values["radio"] = started(radio, radio_start_s)
    return Setup(**values)


def setup_from_text(
    text: str, *, changes: Mapping[str, Any] = _NOTHING, radio_start_s: float | None = None
) -> Setup:
    """A setup from the text of a TOML file, as `setup_text.setup_toml` writes it.

    changes, radio_start_s: as of `load_setup`. Raises ConfigError for a text that is not a setup.
    """
    return load_setup(parse_toml(text, "its setup"), changes=changes, radio_start_s=radio_start_s)


def _values_of(name: str | Mapping[str, Any]) -> Mapping[str, Any]:
    """The fields of `Setup`; the radio is still a name."""
    if isinstance(name, Mapping):
        _refuse_counted_axes(name)
        return setup_values(typed(name, SETUP_FILE, "a setup"))
    if name in BUILT_IN:
        return {each.name: getattr(BUILT_IN[name], each.name) for each in fields(Setup)}
    table = table_of_setup(name)
    with refused(f"setup {name}", ConfigError):
        return _values_of(table)


def _refuse_counted_axes(table: Mapping[str, Any]) -> None:
    """Axes were a number and a gripper."""
    count = table.get("axes", ())
    if "gripper" in table or not isinstance(count, list | tuple):
        more = AXIS_NAMES[: int(count) - 2] if count in (3, 6) else ()
        names = ["x", "y", *more, *(["gripper"] if table.get("gripper") else [])]
        listed = ", ".join(f'"{each}"' for each in names)
        raise ConfigError(f"axes are a list of names now, without gripper: axes = [{listed}]")


def table_of_setup(name: str) -> Mapping[str, Any]:
    """The table that the TOML file of a setup holds, also of one that is built in; ConfigError."""
    if name in BUILT_IN:
        return setup_table(BUILT_IN[name])
    path = Path(name)
    if path.suffix != ".toml":
        raise ConfigError(
            f"unknown setup {name}: take {' or '.join(sorted(BUILT_IN))}, or a file NAME.toml"
        )
    table = read_toml(path, "setup")
    if not table.keys().isdisjoint(("setup", "include")):
        raise ConfigError(f"{name} is a site file: give it without --setup")
    return {"name": path.stem, **table}


def setup_from_table(
    table: Mapping[str, Any],
    *,
    changes: Mapping[str, Any] = _NOTHING,
    radio_start_s: float | None = None,
) -> Setup:
    """A setup from the table that a TOML file holds; changes, radio_start_s: as of `load_setup`."""
    return load_setup(table, changes=changes, radio_start_s=radio_start_s)
