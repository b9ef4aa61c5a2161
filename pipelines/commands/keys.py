"""`kontur-av keys`: this machine's key, its identity, and the identities that it trusts."""

import argparse
from pathlib import Path

from pipelines.link.key_files import (
    default_key_path,
    forget,
    make_key,
    read_key,
    trust,
    trusted_identities,
)
from pipelines.session.option_rows import add_actions, add_options
from telepresence.link.protection.identity import MachineIdentity

#: By action: what it does.
_ACTIONS = {
    "new": "make this machine's key",
    "show": "print this machine's identity, a line",
    "trust": "trust an identity",
    "list": "print the trusted identities",
    "forget": "trust an identity no more",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = add_actions(parser, {name: (text,) for name, text in _ACTIONS.items()})
    for name, action in actions.items():
        if name in ("trust", "forget"):
            # The groups may stand apart, as one copies them from a note.
            action.add_argument("identity", nargs="+", metavar="IDENTITY")
        add_options(action, "--key")


def run(args: argparse.Namespace) -> int:
    path: Path = default_key_path() if args.key is None else args.key
    if args.action == "new":
        identity = make_key(path).identity
        print(f"{path} is this machine's key. Its identity, for the other machine:\n{identity}")
    elif args.action == "show":
        print(read_key(path).identity)
    elif args.action == "list":
        for identity in trusted_identities(path):
            print(identity)
    else:
        identity = MachineIdentity.parse(" ".join(args.identity))
        if args.action == "trust":
            new = trust(path, identity)
            print(f"{identity} is trusted" if new else f"{identity} was trusted already")
        else:
            forget(path, identity)
            print(f"{identity} is trusted no more")
    return 0
