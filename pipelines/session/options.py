# ruff: noqa: RUF009 (each default is a field)
"""The options of a session: each is declared once, as a field of `StreamOptions`.

Arguments of the commands, keys of site files, `stream --explain` and the documents derive from it.
"""

import argparse
import re
from collections.abc import Iterable, Mapping
from dataclasses import Field, dataclass, field, fields
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from kontur_av.errors import ConfigError
from pipelines.session.option_rows import COMMON_ROWS
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import NO_RADIO, Deadband, ForceMode, HandMode, PathForm, Setup
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import SIMULATED
from telepresence.link.profile import Repair
from telepresence.link.radio.profile import BUILT_IN as RADIOS
from telepresence.link.radio.profile_file import load_radio

#: The ports of the first page and of a partner, without an option.
PAGE_PORT, RTC_PORT = "8270", "8290"
#: What files may take at most, by the end that sends them, without an option.
FILES_BPS = {Segment.GROUND: 8_000, Segment.SPACE: 200_000}
FILES_KBPS = ",".join(f"{bps / 1000:g}" for bps in FILES_BPS.values())


GROUPS = ("session", "inputs", "robot", "radio", "two machines", "pages", "outlets")


def _declare(group: str, row: str, default: object = None, **more: object) -> Any:
    """A field of `StreamOptions`. row: `NAME METAVAR  HELP`, or a common row's first name.

    NAME is a short second name. Flags and choices have no METAVAR. `*` begins a row that the short
    help has. more, as metadata: `bare`, the value of the option without one; `off`, the help of
    `--no-NAME`; `rivals`, the options that it replaces, and that cannot be given with it; `like`,
    its values in a file.
    """
    first, row = row.startswith("*"), row.removeprefix("*")
    head, _, text = COMMON_ROWS.get(row, row).rpartition("  ")
    words = [word.rstrip(",") for word in head.split()]
    metavar = " ".join(word for word in words if not word.startswith(("-", "<")))
    short = [word for word in words if re.fullmatch("-[a-z]", word)]
    more |= {"group": group, "first": first, "metavar": metavar, "text": text, "short": short}
    return field(default=() if metavar.startswith("NAME=") else default, metadata=more)


_session, _inputs, _robot, _radio, _far, _pages, _outlets = (
    partial(_declare, group) for group in GROUPS
)


@dataclass(frozen=True, kw_only=True)
class StreamOptions:
    """What the user asks of a session, by command line and site file."""

    setup: str | Mapping[str, Any] | None = _session(
        "*NAME  spacejustin, taskboard or FILE.toml", like="a name or a table [setup]"
    )
    seconds: float | None = _session("*--seconds")
    record: Path | None = _session("*FILE.mcap  record the session")
    report: Path | None = _session("*--report")
    tasks: tuple[Path, ...] | None = _session(
        "*FILE.xml  have tasks that people select; with files, further ones", bare=()
    )
    quiet: bool = _session("*-q", False, rivals=("verbose",))
    overwrite: bool = _session("replace files that exist", False)
    link_frames: bool = _session("record every frame of the radio link, too", False)
    record_cameras: Literal["all", "carried"] | None = _session(
        "all: each at its full rate (the default, if the disk has room for an hour); carried: "
        "those that no stream carries at 5 Hz"
    )
    part_seconds: float = _session(
        "S  begin a new part of the recording after S seconds (default 600)", 600.0
    )
    part_mb: float = _session("M  or after M MB (default 256)", 256.0)
    snapshots: Path | None = _session("DIR  keep what is shown as PNG")
    plan: Path | None = _session(
        "PLAN.toml  a plan's tasks; with a simulated joystick a simulated cosmonaut does them"
    )
    leds: str | None = _session("HOST:PORT  an LED panel instead of the built-in")
    runs: Path | None = _session("DIR  record each run of a task into a file there")
    telemetry: tuple[str, ...] = _session(
        "SPEC  your component in telemetry: module:Class, at both ends; repeatable", ()
    )
    routes: Path | None = _session(
        "FILE.xml  which data go to your components, or to ground; at both ends"
    )
    trainer: bool = _session(
        "heed `kontur-av trainer`; with --end space, the radio of both directions is here", False
    )
    base_port: int | None = _session("--base-port")
    verbose: bool = _session("-v  show each process' CPU", False, rivals=("quiet",))

    source: tuple[str, ...] = _inputs(
        "*NAME=SPEC  what an input captures: a media file, rtsp://HOST/PATH, mcap:FILE#CHANNEL, "
        "pipe:PATH, v4l2:DEVICE, alsa:DEVICE, scene:NAME, page for a browser page alone, or topic "
        "for a program; repeatable"
    )

    robot: str = _robot(
        "*SPEC  sim (the default), udp:HOST:PORT[:KEYFILE] or your own module:Class",
        SIMULATED_ROBOT,
    )
    joystick: str = _robot(
        "*SPEC  sim (the default), page (the hand at the operator's page), ros2 (a node's), "
        "evdev[:/dev/input/eventN], udp:HOST:PORT[:KEYFILE] or your own module:Class; see "
        "`kontur-av joystick list`",
        SIMULATED,
    )
    joystick_map: Path | None = _robot("--joystick-map")
    second_robot: str = _robot("SPEC  the partner's arm, as --robot", SIMULATED_ROBOT)
    hand: HandMode | None = _robot(
        "direct: the robot's delayed force is felt; mediated: a wall rendered at the joystick; "
        "auto: that wall, and other force directly; adaptive (the default): auto from a round trip "
        "of 60 ms on"
    )
    force: ForceMode | None = _robot(
        "none: the hand feels nothing, and pictures get the room (default: felt)"
    )
    deadband: Deadband | None = _robot(
        "leave out haptic samples that nobody would miss; the uplink video gets a higher rate "
        "(picture, the default) or a lower delay (latency)",
        bare="picture",
    )

    radio: str | None = _radio(
        f"*PROFILE  {', '.join(RADIOS)} or FILE.toml", rivals=("radio_delay_ms",)
    )
    repair: Repair | None = _radio(
        "restore lost frames from idle slots (idle), at losses also from the room of pictures "
        "left out (auto, the default)"
    )
    radio_start: float | None = _radio(
        "S  begin S seconds after a pass's acquisition of signal (negative: before it)"
    )
    radio_delay_ms: float | None = _radio("D  a cable with a delay one way", rivals=("radio",))
    seed: int = _radio("N  seed of the radio's random losses", 0)
    bypass: bool = _radio("for tests: join the programs directly, past gateways and radio", False)

    end: Literal["ground", "space"] | None = _far(
        "*run this end alone; --listen or --peer says how it meets the other"
    )
    listen: str | None = _far(
        "*ADDR:PORT  wait for the other end at this UDP port; 0.0.0.0 or [::]: every address",
        rivals=("peer",),
    )
    peer: str | None = _far("*HOST:PORT  call the other end there", rivals=("listen",))
    key: Path | None = _far("--key", rivals=("insecure",))
    identity: str | None = _far(
        "ID  the other machine's, if several are trusted", rivals=("insecure",)
    )
    insecure: bool = _far(
        "neither encrypt nor authenticate; on a private network only",
        False,
        rivals=("key", "identity", "path_batch_ms", "path"),
    )
    path: PathForm | None = _far(
        "compact: without what is idle, which shows an eavesdropper how much is sent (default: "
        "slots)",
        rivals=("insecure",),
    )
    path_batch_ms: int | None = _far(
        "MS  a datagram has the frames of 1 (the default), 2 or 4 ms", rivals=("insecure",)
    )

    page: str | bool | None = _pages(
        f"*[HOST:]PORT  where the browser pages are served (default 127.0.0.1:{PAGE_PORT}, or the "
        "next free ports); TLS beyond loopback",
        off="serve no browser pages",
    )
    open: bool = _pages("*open the first page in a browser", False)
    page_cert: Path | None = _pages(
        "FILE  PEM file with certificate and key for the pages (default: made)"
    )
    rtc: str | None = _pages(
        f"[HOST:]PORT  serve a partner by WebRTC (default 127.0.0.1:{RTC_PORT}); TLS beyond "
        "loopback",
        bare=RTC_PORT,
    )
    rtc_token_file: Path | None = _pages(
        "FILE  the partner's token to watch and to send (default: a new one)"
    )
    rtc_hand_token_file: Path | None = _pages("FILE  its token to steer (default: a new one)")
    ice_server: str | None = _pages(
        "URL  stun:HOST[:PORT] or turn:HOST[:PORT][?transport=tcp] (default: as the media server "
        "says)"
    )
    turn_secret_file: Path | None = _pages(
        "FILE  shared with a TURN server, for credentials of one hour (coturn's use-auth-secret)",
        rivals=("turn_user",),
    )
    turn_user: str | None = _pages("USER  a lasting user name there", rivals=("turn_secret_file",))
    turn_password_file: Path | None = _pages("FILE  with --turn-user")
    ice_relay_only: bool = _pages(
        "go through the TURN server only; tell no address of this machine", False
    )

    metrics: str | None = _outlets(
        "*[HOST:]PORT  serve figures to Prometheus at /metrics, and /healthz, to everyone who "
        "reaches the port (default 127.0.0.1:9270)",
        bare="9270",
    )
    foxglove: str | None = _outlets(
        "*[HOST:]PORT  serve the channels of a recording to Foxglove and Lichtblick (default "
        "127.0.0.1:8765); TLS beyond loopback",
        bare="8765",
    )
    ros2: str | None = _outlets(
        "*[HOST:]PORT  be a node of ROS 2, in ROS_DOMAIN_ID, by this router of rmw_zenoh (default "
        "127.0.0.1:7447); everyone who reaches it sees and hears the session",
        bare="7447",
    )
    files: Path | None = _outlets(
        "*DIR  carry files between DIR/ground and DIR/space; see `kontur-av file`"
    )
    packets: str | None = _outlets(
        "tcp:[HOST:]PORT|udp:HOST:PORT  telemetry to another ground system, and its telecommands: "
        "tcp listens; udp sends to PORT, and takes those of HOST at PORT + 1"
    )
    packets_allow: tuple[str, ...] = _outlets(
        "WHAT  telecommands that may come by --packets: APPLICATION, APPLICATION.FUNCTION or all; "
        "repeatable (default: questions alone)",
        (),
    )
    frames: str | None = _outlets(
        "udp:HOST:PORT  copies of the link's frames to another ground system: the downlink's to "
        "PORT, the uplink's to PORT + 1"
    )
    files_rate: str | None = _outlets(
        f"UP,DOWN  the most that files take, in kbit/s (default {FILES_KBPS})",
        like="two numbers, like [8, 200]",
    )
    service: tuple[str, ...] = _outlets(
        "NAME=PORT  lead TCP connections from PORT here to the other end's service NAME; needs "
        "--files; repeatable"
    )
    service_allow: tuple[str, ...] = _outlets(
        "NAME=HOST:PORT  let the other end connect to HOST:PORT as service NAME; repeatable"
    )

    def __post_init__(self) -> None:
        for name, option in OPTIONS.items():
            for rival in option.metadata.get("rivals", ()):
                if is_given(self, name) and is_given(self, rival) and name < rival:
                    raise ConfigError(f"{flag(name)} and {flag(rival)}: give one of them")


#: By name.
OPTIONS: Mapping[str, Field[Any]] = {option.name: option for option in fields(StreamOptions)}


@cache
def kinds_of(name: str) -> tuple[Any, ...]:
    """The types of an option's value, without None: a tuple's first."""
    hint = get_type_hints(StreamOptions)[name]
    kinds = (hint,) if get_origin(hint) in (None, tuple, Literal) else get_args(hint)
    return tuple(kind for kind in kinds if kind is not type(None))


def is_given(options: StreamOptions, name: str) -> bool:
    value = getattr(options, name)
    return not (value is None or value is False or value == ())


def flag(name: str) -> str:
    """`--radio-start` of `radio_start`."""
    return f"--{name.replace('_', '-')}"


class _ShortHelp(argparse.Action):
    """Prints the help without the actions in `const`."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        for action in self.const:
            action.help = argparse.SUPPRESS
        parser.print_help()
        parser.exit()


def add_grouped_options(parser: argparse.ArgumentParser) -> None:
    """Add all options, `-h` for those that newcomers need, and `--help-all`.

    They have no defaults here, because a site file may give a value. `--no-NAME` takes it back.
    """
    rare: list[argparse.Action] = []
    unset: Mapping[str, Any] = {"default": argparse.SUPPRESS}
    short: Mapping[str, Any] = {"action": _ShortHelp, "nargs": 0, "const": rare, **unset}
    parser.add_argument("-h", "--help", help="show the frequent options", **short)
    parser.add_argument("--help-all", help="show all options", action="help")
    groups = {group: parser.add_argument_group(group) for group in GROUPS}
    for name, option in OPTIONS.items():
        either = groups[option.metadata["group"]].add_mutually_exclusive_group()
        action = _add(either, name, **unset)
        off = option.metadata.get("off", argparse.SUPPRESS)
        either.add_argument(flag(f"no_{name}"), dest=name, action="store_false", help=off, **unset)
        rare += [action] * (not option.metadata["first"])
    parser.usage = "%(prog)s [FILE.toml] [OPTIONS]"


def add_session_options(parser: argparse._ActionsContainer, *names: str) -> None:
    """Add options by the names of their fields.

    One that ends in `!` must be given; `NAME=VALUE` has another default.
    """
    for entry in names:
        name, equals, default = entry.rstrip("!").partition("=")
        action = _add(parser, name)
        if equals:
            action.default, action.help = default, f"{action.help} (default {default})"
        action.required = entry.endswith("!")


def _add(parser: argparse._ActionsContainer, name: str, **more: object) -> argparse.Action:
    known, kind = OPTIONS[name].metadata, kinds_of(name)[0]
    own: Mapping[str, Any] = {"metavar": known["metavar"], "type": kind}
    if kind is bool:
        own = {"action": "store_true"}
    elif get_origin(kind) is Literal:
        own = {"choices": get_args(kind)}
    elif get_origin(kind) is tuple:
        how = {"nargs": "*"} if "bare" in known else {"action": "append", "default": []}
        own = {**own, "type": get_args(kind)[0], **how}
    if "bare" in known and "nargs" not in own:
        own = {**own, "nargs": "?", "const": known["bare"]}
    own = {"help": known["text"], "default": OPTIONS[name].default, **own, **more}
    return parser.add_argument(*known["short"], flag(name), **own)


def stream_options(args: argparse.Namespace) -> StreamOptions:
    """The options that a command has, all others as they are without; ConfigError."""
    values: Mapping[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in vars(args).items()
        if name in OPTIONS
    }
    return StreamOptions(**values)


def setup_changes(options: StreamOptions) -> Mapping[str, Any]:
    """What the options change in the setup."""
    names = ("base_port", "deadband", "hand", "force", "repair", "path", "path_batch_ms")
    changes = {name: getattr(options, name) for name in names}
    changes["recorded_cameras"] = options.record_cameras
    if options.radio is not None:
        changes |= {"radio": load_radio(options.radio), "radio_delay_ms": 0.0}
    elif options.radio_delay_ms is not None:
        changes |= {"radio": NO_RADIO, "radio_delay_ms": options.radio_delay_ms}
    return {name: value for name, value in changes.items() if value is not None}


def asked_setup(options: StreamOptions) -> Setup:
    """The setup, with what the options change in it; ConfigError."""
    if options.setup is None:
        raise ConfigError('--setup is missing: give it, or setup = "NAME" in a site file')
    return load_setup(
        options.setup,
        sources=_sources(options.source),
        changes=setup_changes(options),
        radio_start_s=options.radio_start,
    )


def _sources(options: Iterable[str]) -> Mapping[str, str]:
    """NAME=SPEC options as a table; the last one of each name counts."""
    sources = {}
    for option in options:
        name, equals, spec = option.partition("=")
        if not (name and equals and spec):
            raise ConfigError(f"--source {option}: write NAME=SPEC, like head=clip.mp4")
        sources[current(name, INPUTS)] = spec
    return sources
