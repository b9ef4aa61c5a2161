"""`kontur-av info`: what is in a recording, gaps and losses included."""

import argparse
import shutil
from pathlib import Path

from kontur_av.errors import ProtocolError, refused
from pipelines.recording.inventory import inventory_lines, take_inventory
from pipelines.recording.recording_file import octets_of_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.mcap", type=Path, help="a recording; torn ones, too")


def run(args: argparse.Namespace) -> int:
    with refused(args.file, ProtocolError):
        inventory = take_inventory(octets_of_file(args.file))
    width = shutil.get_terminal_size().columns
    print("\n".join(inventory_lines(inventory, str(args.file), width)))
    return 0
