"""`kontur-av yamcs new`: the directory of a YAMCS instance that reads what a session sends."""

import argparse
from pathlib import Path

from kontur_av.errors import ConfigError, refused
from pipelines.commands.session_parts import load_routes
from pipelines.mission.supervisor import session_dictionary
from pipelines.packets.process_packets import DEFAULT_PACKETS, parse_frames, parse_packets
from pipelines.packets.yamcs import instance_files
from pipelines.session.command_process import print_data
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.xtce import dictionary_xtce
from telepresence.tmtc.telemetry_source import load_components

_HTTP_PORT = 8090


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "write the instance's directory: etc/ and mdb/"
    new = actions.add_parser("new", help=text, description=text)
    new.add_argument("directory", type=Path, metavar="DIR")
    add_session_options(new, "setup=spacejustin", "telemetry", "routes", "frames")
    add_options(
        new,
        f"--packets tcp:[HOST:]PORT|udp:HOST:PORT <={DEFAULT_PACKETS}>  as of `stream`, with the "
        f"session's host (default: {DEFAULT_PACKETS})",
        f"--end <{'|'.join(segment.value for segment in Segment)}={Segment.GROUND.value}>  that it "
        "is joined to (default: ground)",
        f"--http-port PORT <port={_HTTP_PORT}>  of YAMCS",
    )


def run(args: argparse.Namespace) -> int:
    options, frames = parse_packets(args.packets), parse_frames(args.frames)
    known = built_in_dictionary()
    components = load_components(args.telemetry, known)
    topology = topology_of(
        load_setup(args.setup), components=components, routes=load_routes(args.routes)
    )
    dictionary = session_dictionary(known, topology)
    files = instance_files(
        dictionary_xtce(dictionary, args.end),
        options.address,
        udp=options.udp,
        frames_port=None if frames is None else frames[1],
        http_port=args.http_port,
    )
    directory: Path = args.directory
    if taken := [name for name in files if (directory / name).exists()]:
        raise ConfigError(f"{directory / taken[0]} is there already: name another directory")
    with refused(directory):
        for name, text in files.items():
            (directory / name).parent.mkdir(parents=True, exist_ok=True)
            (directory / name).write_text(text, encoding="utf-8")
    print_data(f"{directory} is written. In it start org.yamcs.YamcsServer: docs/telemetry.md\n")
    return 0
