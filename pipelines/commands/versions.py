"""`kontur-av versions`: versions of the communication software, and a way back from each."""

import argparse
from pathlib import Path

from kontur_av.clock import NS_PER_S
from pipelines.link.key_files import default_key_path, read_key, trusted_identities
from pipelines.session.command_process import say, stopped_by_signals
from pipelines.session.option_rows import add_actions
from pipelines.upkeep.requests import DiskStore
from pipelines.upkeep.version_keeper import VersionKeeper
from telepresence.upkeep.file_store import read_folder, replace_file
from telepresence.upkeep.manifest import MANIFEST, signed_manifest
from telepresence.upkeep.version_stack import ELEMENTARY, VersionLimits

_SECONDS = VersionLimits().probation_ns // NS_PER_S
_DIRECTORY, _NAME = "directory DIR <Path>  of all versions", "name NAME"
_CALLED = f"--name <>  of the version; default: the folder's; {ELEMENTARY} for that one"
#: By action: what it does, and its options.
_ACTIONS = {
    "sign": (
        "write the manifest of a version: checksums, signed by this machine's key",
        *("folder FOLDER <Path>  has the file `run`", _CALLED, "--key"),
    ),
    "add": (
        "take over a signed version; it is not started",
        *(_DIRECTORY, "folder FOLDER <Path>  of the version", _CALLED, "--key"),
    ),
    "list": (
        "print the versions, the one that worked last first",
        _DIRECTORY,
    ),
    "start": (
        "start a version; a new one is on probation, a defective one is new again",
        *(_DIRECTORY, _NAME),
    ),
    "confirm": (
        "say that the running version works, where no program can tell",
        *(_DIRECTORY, _NAME),
    ),
    "remove": (
        "delete a version that does not run; the elementary one stays",
        *(_DIRECTORY, _NAME),
    ),
    "run": (
        "run the current version, and watch it",
        _DIRECTORY,
        f"--probation S <float={_SECONDS}>  allowed contact without application data (default: "
        f"{_SECONDS})",
        *("arguments ARGUMENT <...>  after --: of run", "--inbox", "--key"),
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_actions(parser, _ACTIONS)


def run(args: argparse.Namespace) -> int:
    key_path: Path = getattr(args, "key", None) or default_key_path()
    if args.action == "sign":
        store = DiskStore(args.folder)
        name = args.name or args.folder.absolute().name
        manifest = signed_manifest(name, read_folder(store, ""), read_key(key_path))
        replace_file(store, MANIFEST, manifest)
        say(f"version {name} is signed by {read_key(key_path).identity}")
        return 0
    trusted = []
    if args.action in ("add", "run"):
        trusted = [read_key(key_path).identity, *trusted_identities(key_path)]
    keeper = VersionKeeper(args.directory, trusted, say)
    if args.action == "list":
        _print_list(keeper)
    elif args.action == "add":
        name = args.name or args.folder.absolute().name
        keeper.add(name, args.folder)
        say(f"version {name} is there: `kontur-av versions start {args.directory} {name}`")
    elif args.action == "run":
        limits = VersionLimits(probation_ns=round(args.probation * NS_PER_S))
        with stopped_by_signals() as stopped:
            keeper.run(args.arguments, stopped, limits, args.inbox)
    else:
        keeper.order(args.action, args.name)
    return 0


def _print_list(keeper: VersionKeeper) -> None:
    record, runs = keeper.read(), keeper.runs
    rows = [(name, state.value) for name, state in record.versions]
    for name, state in [*rows, (ELEMENTARY, "always there")]:
        notes = ["runs" if runs else "runs next"] if name == record.current else []
        notes += ["set aside"] if name in record.tried else []
        say("  ".join([f"{name:<20}", f"{state:<12}", ", ".join(notes)]).rstrip())
