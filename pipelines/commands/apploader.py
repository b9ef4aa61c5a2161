"""`kontur-av apploader`: run the joystick's software from the copy that works, and update it."""

import argparse

from kontur_av.errors import ConfigError, refused
from kontur_av.hosts import parse_address
from pipelines.session.command_process import say, stopped_by_signals
from pipelines.session.datagrams import LOOPBACK
from pipelines.session.option_rows import add_actions
from pipelines.upkeep.loader_keeper import LoaderKeeper, check_ftp_url, list_lines, serve_ftp
from pipelines.upkeep.requests import DiskStore
from telepresence.upkeep.app_loader import BootDevice, Copy
from telepresence.upkeep.file_store import read_folder, replace_file
from telepresence.upkeep.manifest import SFV, sfv_text

_PORT = 2121
_DIRECTORY = "directory DIR <Path>  has the storages"
_FOLDER = "folder FOLDER <Path>  has the file `run`"
_BOOT = (
    f"--boot <{'|'.join(device.value for device in BootDevice)}={BootDevice.SD.value}>  where the "
    "kernel came from; flash: the pair is on FTP"
)
#: By action: what it does, and its options.
_ACTIONS = {
    "run": (
        "run the desired copy, or another one if it fails",
        *(_DIRECTORY, _BOOT, "--ftp URL  with flash: fetch folders 1 and 2 there"),
        *("arguments ARGUMENT <...>  after --: of run", "--inbox"),
    ),
    "list": ("verify all copies, and print the desired mode", _DIRECTORY),
    "update": ("write an update to prime; it is tried next", _DIRECTORY, _FOLDER, _BOOT),
    "copy": ("copy prime to backup, once it has worked", _DIRECTORY, _BOOT),
    "shutdown": ("end the running software in good order", _DIRECTORY),
    "fill": (
        *("write a copy as it was at delivery", _DIRECTORY),
        *(f"copy <{'|'.join(copy.value for copy in Copy)}>  the storage", _FOLDER),
    ),
    "sfv": ("write the checksums of a folder, as cksfv reads them", _FOLDER),
    "serve": (
        *("serve the copies of one storage by FTP", _DIRECTORY, "--storage <sd|ftp=sd>"),
        f"--listen HOST:PORT <={LOOPBACK}:{_PORT}>  default: {LOOPBACK}:{_PORT}; FTP is not "
        "protected",
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_actions(parser, _ACTIONS)


def run(args: argparse.Namespace) -> int:
    if args.action == "sfv":
        if not args.folder.is_dir():
            raise ConfigError(f"{args.folder} is no folder")
        store = DiskStore(args.folder)
        with refused(args.folder):
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
