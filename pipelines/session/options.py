"""The options of a session that several commands share."""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from kontur_av.errors import ConfigError
from pipelines.session.option_rows import add_options
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import DEADBANDS, HAND_MODES, NO_RADIO, Setup
from telepresence.link.radio.profile import BUILT_IN as RADIOS
from telepresence.link.radio.profile_file import load_radio


def add_setup_argument(
    parser: argparse.ArgumentParser, *, default: str | None = None, needed: bool = True
) -> None:
    """`--setup`, which must be given where it has no default; needed: False if it need not be."""
    parser.add_argument(
        "--setup",
        required=needed and default is None,
        default=default,
        metavar="NAME",
        help=f"spacejustin, taskboard or FILE.toml{_said(default)}",
    )


def add_source_argument(parser: argparse.ArgumentParser, kinds: str) -> None:
    """`--source`. kinds: what a SPEC may be."""
    add_options(parser, f"--source NAME=SPEC <*>  what an input captures: {kinds}; repeatable")


def add_radio_argument(parser: argparse.ArgumentParser, *, default: str | None = None) -> None:
    parser.add_argument(
        "--radio",
        default=default,
        metavar="PROFILE",
        help=f"{', '.join(RADIOS)} or FILE.toml{_said(default)}",
    )


def _said(default: str | None) -> str:
    return "" if default is None else f" (default {default})"


def add_radio_arguments(parser: argparse.ArgumentParser, *, delay: bool = True) -> None:
    """`--radio`, `--radio-start`, `--seed` and, with `delay`, `--radio-delay-ms`."""
    add_radio_argument(parser)
    add_options(
        parser,
        "--radio-start S <float>  begin S seconds after a pass's acquisition of signal (negative: "
        "before it)",
    )
    if delay:
        add_options(parser, "--radio-delay-ms D <float>  a cable with a delay one way")
    add_options(parser, "--seed N <int=0>  seed of the radio's random losses")


def radio_change(name_or_file: str) -> dict[str, Any]:
    return {"radio": load_radio(name_or_file), "radio_delay_ms": 0.0}


def radio_changes(args: argparse.Namespace) -> dict[str, Any]:
    delay_ms = getattr(args, "radio_delay_ms", None)
    if args.radio is not None and delay_ms is not None:
        raise ConfigError("--radio and --radio-delay-ms: give one of them")
    if args.radio is not None:
        return radio_change(args.radio)
    if delay_ms is not None:
        return {"radio": NO_RADIO, "radio_delay_ms": delay_ms}
    return {}


def add_deadband_argument(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"--deadband <{'|'.join(DEADBANDS)}?=picture>  leave out haptic samples that nobody would "
        "miss; the uplink video gets their room, as a higher rate (picture, the default) or a "
        "lower delay (latency)",
    )


def add_hand_argument(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"--hand <{'|'.join(HAND_MODES)}>  what the hand feels: the robot's delayed force "
        "(direct, the default), the wall that the robot's side has estimated, rendered at the "
        "joystick (mediated), or that wall and all other force directly (auto)",
    )


def setup_changes(args: argparse.Namespace) -> dict[str, Any]:
    """What the options of this module, those that the command has, change in its setup."""
    given = {name: getattr(args, name, None) for name in ("base_port", "deadband", "hand")}
    changes = radio_changes(args) if hasattr(args, "radio") else {}
    return changes | {name: value for name, value in given.items() if value is not None}


def asked_setup(args: argparse.Namespace) -> Setup:
    """The setup of `--setup`, with what the options of this module change; ConfigError."""
    return load_setup(
        args.setup,
        sources=_sources(getattr(args, "source", ())),
        changes=setup_changes(args),
        radio_start_s=args.radio_start,
    )


def _sources(options: Sequence[str]) -> Mapping[str, str]:
    """NAME=SPEC options as a table; the last one of each name counts."""
    sources = {}
    for option in options:
        name, equals, spec = option.partition("=")
        if not (name and equals and spec):
            raise ConfigError(f"--source {option}: write NAME=SPEC, like head=clip.mp4")
        sources[current(name, INPUTS)] = spec
    return sources


def add_coding_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--recode  code the recorded pictures anew, by the session's encoder",
        "--cap-kbps STREAM=KBPS <*>  another cap for a replayed stream, like uplink_video=60; "
        "repeatable",
    )
