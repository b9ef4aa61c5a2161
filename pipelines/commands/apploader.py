"""`kontur-av apploader`: run the joystick's software from the copy that works, and update it."""

import argparse
from pathlib import Path

from pipelines.session.addresses import parse_address
from pipelines.session.children import stopped_by_signals
from pipelines.session.datagrams import LOOPBACK
from pipelines.session.options import add_options
from pipelines.session.output import say
from pipelines.upkeep.desk import DiskStore
from pipelines.upkeep.ftp import check_ftp_url, serve_ftp
from pipelines.upkeep.loader_keeper import LoaderKeeper, list_lines
from telepresence.upkeep.app_loader import BootDevice, Copy
from telepresence.upkeep.file_store import read_folder, replace_file
from telepresence.upkeep.manifest import SFV, sfv_text

_ACTIONS = {
    "run": "start the desired copy, watch it, and take another one if it fails",
    "list": "verify all copies, and print the desired mode",
    "update": "write an update to prime; it is tried next",
    "copy": "copy prime to backup, once it has worked",
    "shutdown": "end the running software in good order",
    "fill": "write a copy as it was at delivery",
    "sfv": "write the list of checksums of a folder; cksfv reads it, too",
    "serve": "an FTP server for the copies of one storage",
}
_PORT = 2121


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, text in _ACTIONS.items():
        action = actions.add_parser(name, help=text, description=text)
        if name != "sfv":
            action.add_argument("directory", type=Path, metavar="DIR", help="has the storages")
        if name == "fill":
            action.add_argument("copy", choices=[copy.value for copy in Copy], help="the storage")
        if name in ("update", "fill", "sfv"):
            action.add_argument("folder", type=Path, metavar="FOLDER", help="has the file `run`")
        if name in ("run", "update", "copy"):
            action.add_argument(
                "--boot",
                choices=[device.value for device in BootDevice],
                default=BootDevice.SD.value,
                help="where the kernel came from; with flash the two FTP folders are the pair",
            )
        if name == "run":
            add_options(action, "--ftp URL  with flash: fetch folders 1 and 2 from this server")
            action.add_argument("arguments", nargs="*", metavar="ARGUMENT", help="after --: of run")
            add_options(action, "--inbox")
        if name == "serve":
            add_options(
                action,
                "--storage <sd|ftp=sd>",
                f"--listen HOST:PORT <={LOOPBACK}:{_PORT}>  default: {LOOPBACK}:{_PORT}; FTP has "
                "no protection of its own",
            )


def run(args: argparse.Namespace) -> int:
    if args.action == "sfv":
        store = DiskStore(args.folder)
        files = {name: file for name, file in read_folder(store, "").items() if name != SFV}
        replace_file(store, SFV, sfv_text(files))
        return 0
    if args.action == "list":
        say("\n".join(list_lines(DiskStore(args.directory))))
        return 0
    if args.action == "serve":
        address = parse_address(args.listen, "--listen")
        with stopped_by_signals() as stopped:
            serve_ftp(args.directory / args.storage, address, say, stopped)
        return 0
    keeper = LoaderKeeper(args.directory, say)
    if args.action == "fill":
        keeper.fill(Copy(args.copy), args.folder)
    elif args.action == "update":
        keeper.update(args.folder, BootDevice(args.boot))
    elif args.action == "copy":
        keeper.copy_to_backup(BootDevice(args.boot))
    elif args.action == "shutdown":
        keeper.shutdown()
    else:
        if args.ftp is not None:
            check_ftp_url(args.ftp)
        with stopped_by_signals() as stopped:
            device = BootDevice(args.boot)
            keeper.run(device, args.arguments, stopped, args.ftp, args.inbox)
    return 0
