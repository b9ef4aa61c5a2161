# ruff: noqa: RUF009 (each default is a field)
"""The options of a session: each is declared once, as a field of `StreamOptions`.

Arguments of the commands, keys of site files, `stream --explain` and the documents derive from it.
"""

import argparse
from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from kontur_av.errors import ConfigError
from pipelines.session.option_rows import COMMON_ROWS, add_options
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import NO_RADIO, Deadband, HandMode, Setup
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import SIMULATED
from telepresence.link.radio.profile import BUILT_IN as RADIOS
from telepresence.link.radio.profile_file import load_radio

#: The ports of the first page and of a partner, without an option.
PAGE_PORT, RTC_PORT = "8270", "8290"
#: What files may take at most, by the end that sends them, without an option.
FILES_BPS = {Segment.GROUND: 8_000, Segment.SPACE: 200_000}
_FILES_KBPS = ",".join(f"{bps / 1000:g}" for bps in FILES_BPS.values())


def _group(group: str) -> Callable[..., Any]:
    """Return what declares an option of this group."""

    def declare(row: str = "", default: object = None, **more: object) -> Any:
        """A field of `StreamOptions`. row: `METAVAR  HELP`; of flags and choices only HELP.

        Without a row it is the common one of that name. more, as metadata: `short`, a second name.
        `bare`, the value of the option without one. `first`, whether the short help has it. `off`,
        the help of `--no-NAME`. `rivals`, options that it replaces, and that cannot be given with
        it. `spec`, whether it may name a file. `like`, its values in a site file in words.
        """
        if row.startswith("NAME="):
            default, more["like"] = (), "a table of texts, like [source] or [service]"
        return field(default=default, metadata={"group": group, "row": row, **more})

    return declare


_session, _inputs, _robot, _radio, _pages, _outlets = map(
    _group, ("session", "inputs", "robot", "radio", "pages", "outlets")
)
_LIST = {"default": (), "like": "a list of texts in quotes"}


@dataclass(frozen=True, kw_only=True)
class StreamOptions:
    """What the user asks of a session, by command line and site file."""

    setup: str | Mapping[str, Any] | None = _session(
        "NAME  spacejustin, taskboard or FILE.toml",
        first=True,
        spec=True,
        like="a name or a file in quotes, or a table [setup]",
    )
    seconds: float | None = _session(first=True)
    record: Path | None = _session("FILE.mcap  record the session", first=True)
    overwrite: bool = _session("replace a recording of that name", False)
    link_frames: bool = _session("record every frame of the radio link, too", False)
    part_seconds: float = _session(
        "S  begin a new part of the recording after S seconds (default 600)", 600.0
    )
    part_mb: float = _session("M  or after M MB (default 256)", 256.0)
    report: Path | None = _session(first=True)
    snapshots: Path | None = _session("DIR  keep what is shown as PNG")
    tasks: tuple[Path, ...] | None = _session(
        "FILE.xml  have tasks for people; with files, further ones",
        bare=(),
        first=True,
        like="true, or a list of files in quotes",
    )
    plan: Path | None = _session(
        "PLAN.toml  select the tasks of a plan; with a simulated joystick a simulated cosmonaut "
        "does them"
    )
    leds: str | None = _session("HOST:PORT  of an LED panel that takes the place of the built-in")
    runs: Path | None = _session("DIR  record each run of a task into a file there")
    telemetry: tuple[str, ...] = _session(
        "SPEC  your component in telemetry: module:Class, at both ends; repeatable", **_LIST
    )
    trainer: bool = _session(
        "heed `kontur-av trainer`; with --end space, the radio of both directions is here", False
    )
    base_port: int | None = _session()
    verbose: bool = _session("show each process' CPU", False, short="-v", rivals=("quiet",))
    quiet: bool = _session("", False, short="-q", rivals=("verbose",), first=True)

    source: tuple[str, ...] = _inputs(
        "NAME=SPEC  what an input captures: a media file, mcap:FILE#CHANNEL, pipe:PATH, "
        "v4l2:DEVICE, alsa:DEVICE, scene:NAME, page for a browser page alone, or topic for a "
        "program; repeatable",
        first=True,
        spec=True,
    )

    robot: str = _robot(
        "SPEC  sim, udp:HOST:PORT[:KEYFILE] or your own: module:Class (default: sim)",
        SIMULATED_ROBOT,
        first=True,
        spec=True,
    )
    joystick: str = _robot(
        "SPEC  sim, page (the hand at the operator's page), ros2 (a node's), evdev, "
        "evdev:/dev/input/eventN, udp:HOST:PORT[:KEYFILE] or your own: module:Class (default: "
        "sim); see `kontur-av joystick list`",
        SIMULATED,
        first=True,
        spec=True,
    )
    second_robot: str = _robot("SPEC  the partner's arm, as --robot", SIMULATED_ROBOT, spec=True)
    hand: HandMode | None = _robot(
        "what the hand feels: the robot's delayed force (direct, the default), the wall that the "
        "robot's side has estimated, rendered at the joystick (mediated), or that wall and all "
        "other force directly (auto)"
    )
    deadband: Deadband | None = _robot(
        "leave out haptic samples that nobody would miss; the uplink video gets their room, as a "
        "higher rate (picture, the default) or a lower delay (latency)",
        bare="picture",
    )

    radio: str | None = _radio(
        f"PROFILE  {', '.join(RADIOS)} or FILE.toml",
        first=True,
        spec=True,
        rivals=("radio_delay_ms",),
    )
    radio_start: float | None = _radio(
        "S  begin S seconds after a pass's acquisition of signal (negative: before it)"
    )
    radio_delay_ms: float | None = _radio("D  a cable with a delay one way", rivals=("radio",))
    seed: int = _radio("N  seed of the radio's random losses", 0)
    end: Literal["ground", "space"] | None = _radio(
        "run this end alone; the other runs on another machine", first=True
    )
    listen: str | None = _radio(
        "ADDR:PORT  with --end: wait for the other end at this UDP port; 0.0.0.0 is every address",
        first=True,
        rivals=("peer",),
    )
    peer: str | None = _radio(
        "HOST:PORT  with --end: call the other end, which listens there",
        first=True,
        rivals=("listen",),
    )
    key: Path | None = _radio()
    identity: str | None = _radio(
        "ID  with --end: the other machine's identity, if several are trusted"
    )
    insecure: bool = _radio(
        "with --end: neither encrypt nor authenticate; on a private network only", False
    )
    bypass: bool = _radio(
        "for tests, with both ends here: join the programs directly, past gateways and radio", False
    )

    page: str | bool | None = _pages(
        f"[HOST:]PORT  where the browser pages are served (default 127.0.0.1:{PAGE_PORT}, or the "
        "next free ports); TLS beyond loopback",
        first=True,
        off="serve no browser pages",
        like="a text [HOST:]PORT in quotes, a port, or false",
    )
    open: bool = _pages("open the first page in a browser", False, first=True)
    page_cert: Path | None = _pages(
        "FILE  PEM file with certificate and key for the pages (default: made for the session)"
    )
    rtc: str | None = _pages(
        "[HOST:]PORT  serve a partner across the Internet by WebRTC: it sees and hears both "
        f"sides, and is seen and heard at the ground (default 127.0.0.1:{RTC_PORT}); TLS beyond "
        "loopback",
        bare=RTC_PORT,
    )
    rtc_token_file: Path | None = _pages(
        "FILE  the partner's token to watch and to send (default: a new one for each session)"
    )
    rtc_hand_token_file: Path | None = _pages(
        "FILE  its token to steer (default: a new one for each session)"
    )
    ice_server: str | None = _pages(
        "URL  stun:HOST[:PORT] or turn:HOST[:PORT][?transport=tcp] (default: what the media "
        "server names, if there is one)"
    )
    turn_secret_file: Path | None = _pages(
        "FILE  the secret shared with a TURN server, for credentials of one hour (coturn's "
        "use-auth-secret)"
    )
    turn_user: str | None = _pages("NAME  a lasting user name of the server")
    turn_password_file: Path | None = _pages("FILE  with --turn-user")
    ice_relay_only: bool = _pages(
        "go through the TURN server only, and tell no address of this machine", False
    )

    metrics: str | None = _outlets(
        "[HOST:]PORT  serve all figures to Prometheus at /metrics, and /healthz (default "
        "127.0.0.1:9270); everyone who reaches the port can read them",
        bare="9270",
        first=True,
    )
    foxglove: str | None = _outlets(
        "[HOST:]PORT  serve the channels of a recording to Foxglove and Lichtblick (default "
        "127.0.0.1:8765); TLS beyond loopback",
        bare="8765",
        first=True,
    )
    ros2: str | None = _outlets(
        "[HOST:]PORT  be a node of a ROS 2 system, by the router of rmw_zenoh at this place "
        "(default 127.0.0.1:7447), in the domain of ROS_DOMAIN_ID; everyone who reaches the "
        "router can see and hear the session",
        bare="7447",
        first=True,
    )
    packets: str | None = _outlets(
        "tcp:[HOST:]PORT|udp:HOST:PORT  give telemetry to another ground system, and take its "
        "telecommands: tcp listens; udp sends to PORT, and takes telecommands of HOST at PORT + 1"
    )
    packets_allow: tuple[str, ...] = _outlets(
        "WHAT  telecommands that may come by --packets: APPLICATION, APPLICATION.FUNCTION or all; "
        "repeatable (default: questions alone)",
        **_LIST,
    )
    frames: str | None = _outlets(
        "udp:HOST:PORT  send copies of the radio link's frames to another ground system: the "
        "downlink's to PORT, the uplink's to PORT + 1"
    )
    files: Path | None = _outlets(
        "DIR  carry files: the ground's end has DIR/ground, space has DIR/space; see `kontur-av "
        "file`",
        first=True,
    )
    files_rate: str | None = _outlets(
        "UP,DOWN  the most that files take, in kbit/s from the ground and from space (default "
        f"{_FILES_KBPS}); media always go first",
        like="two numbers, like [8, 200]",
    )
    service: tuple[str, ...] = _outlets(
        "NAME=PORT  lead TCP connections to PORT of this machine to the other end's service NAME; "
        "with both ends here, from the ground to space; needs --files; repeatable"
    )
    service_allow: tuple[str, ...] = _outlets(
        "NAME=HOST:PORT  let the other end connect to HOST:PORT as service NAME; repeatable"
    )

    def __post_init__(self) -> None:
        for name, option in declared().items():
            for rival in option.metadata.get("rivals", ()):
                if is_given(self, name) and is_given(self, rival) and name < rival:
                    raise ConfigError(f"{flag(name)} and {flag(rival)}: give one of them")


@cache
def declared() -> Mapping[str, Field[Any]]:
    return {option.name: option for option in fields(StreamOptions)}


@cache
def hint_of(name: str) -> tuple[Any, ...]:
    """The types of an option's value, without None: a tuple's first."""
    hint = get_type_hints(StreamOptions)[name]
    kinds = (hint,) if get_origin(hint) in (None, tuple, Literal) else get_args(hint)
    return tuple(kind for kind in kinds if kind is not type(None))


def is_given(options: StreamOptions, name: str) -> bool:
    return getattr(options, name) not in (None, False, ())


def flag(name: str) -> str:
    """`--radio-start` of `radio_start`."""
    return f"--{name.replace('_', '-')}"


def add_session_options(
    parser: argparse._ActionsContainer, *names: str, later: bool = False
) -> dict[str, argparse.Action]:
    """Add the options that these fields declare, and return their actions.

    A name that ends in `!` must be given; `NAME=VALUE` has another default. later: without a
    default, because a site file may have a value; and `--no-NAME` takes that value back.
    """
    actions = {}
    for entry in names:
        name, equals, default = entry.rstrip("!").partition("=")
        option = declared()[name]
        more = _argument(option)
        if equals:
            more |= {"default": default, "help": f"{more['help']} (default {default})"}
        if entry.endswith("!"):
            more["required"] = True
        if later:
            more["default"] = argparse.SUPPRESS
        short = [option.metadata["short"]] if "short" in option.metadata else []
        actions[name] = parser.add_argument(*short, flag(name), **more)
        if later:
            off = parser.add_argument(
                flag(f"no_{name}"),
                dest=name,
                action="store_false",
                default=argparse.SUPPRESS,
                help=option.metadata.get("off", argparse.SUPPRESS),
            )
            actions[f"no_{name}"] = off
    return actions


def row_of(option: Field[Any]) -> tuple[str, str]:
    """What an option's value is called, or "", and its help."""
    short = option.metadata.get("short", flag(option.name))
    head, _, text = (option.metadata["row"] or COMMON_ROWS[short]).rpartition("  ")
    return " ".join(word for word in head.split() if not word.startswith(("-", "<"))), text


def _argument(option: Field[Any]) -> dict[str, Any]:
    """What `add_argument` takes for an option, besides its names."""
    metavar, text = row_of(option)
    kind = hint_of(option.name)[0]
    if kind is bool:
        return {"action": "store_true", "help": text}
    more: dict[str, Any] = {"help": text, "default": option.default, "metavar": metavar or None}
    if get_origin(kind) is tuple:
        bare = "bare" in option.metadata
        return (
            more
            | ({"nargs": "*"} if bare else {"action": "append"})
            | {
                "type": get_args(kind)[0],
                "default": None if bare else [],
            }
        )
    if "bare" in option.metadata:
        more |= {"nargs": "?", "const": option.metadata["bare"]}
    if get_origin(kind) is Literal:
        return more | {"choices": get_args(kind)}
    return more | {"type": kind}


def stream_options(args: argparse.Namespace) -> StreamOptions:
    """The options that a command has, all others as they are without; ConfigError."""
    values = {name: value for name, value in vars(args).items() if name in declared()}
    return StreamOptions(
        **{name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    )


def radio_change(name_or_file: str) -> Mapping[str, Any]:
    return {"radio": load_radio(name_or_file), "radio_delay_ms": 0.0}


def setup_changes(options: StreamOptions) -> Mapping[str, Any]:
    """What the options change in the setup."""
    changes: dict[str, Any] = {}
    if options.radio is not None:
        changes |= radio_change(options.radio)
    if options.radio_delay_ms is not None:
        changes |= {"radio": NO_RADIO, "radio_delay_ms": options.radio_delay_ms}
    same = {name: getattr(options, name) for name in ("base_port", "deadband", "hand")}
    return changes | {name: value for name, value in same.items() if value is not None}


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


def add_coding_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--recode  code the recorded pictures anew, by the session's encoder",
        "--cap-kbps STREAM=KBPS <*>  another cap for a replayed stream, like uplink_video=60; "
        "repeatable",
    )
