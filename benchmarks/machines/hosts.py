"""Two hosts for a split session: network namespaces where the machine permits them."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import PORTS

#: Of the network for benchmarks (RFC 2544).
_ADDRESSES = {Segment.GROUND: "198.18.0.1", Segment.SPACE: "198.18.0.2"}


@dataclass(frozen=True, kw_only=True)
class Hosts:
    """Where the two ends run.

    what: in words. prefixes: by end, the words before a command. base_ports: by end.
    ground: the address at which space finds the ground.
    """

    what: str
    prefixes: dict[Segment, tuple[str, ...]]
    base_ports: dict[Segment, int]
    ground: str


@contextmanager
def two_hosts(base_port: int) -> Iterator[Hosts]:
    """Two namespaces with a cable between them; without permission two ends on loopback."""
    names = {segment: f"kav{os.getpid()}-{segment.value}" for segment in Segment}
    try:
        if not _joined(names):
            yield Hosts(
                what="two ends on this machine (namespaces need root and ip(8))",
                prefixes=dict.fromkeys(Segment, ()),
                base_ports={Segment.GROUND: base_port, Segment.SPACE: base_port + PORTS},
                ground="127.0.0.1",
            )
            return
        yield Hosts(
            what="two network namespaces",
            prefixes={segment: ("ip", "netns", "exec", name) for segment, name in names.items()},
            base_ports=dict.fromkeys(Segment, base_port),
            ground=_ADDRESSES[Segment.GROUND],
        )
    finally:
        for name in names.values():
            _ip("netns", "delete", name)


def _joined(names: dict[Segment, str]) -> bool:
    """Whether both namespaces are there, with a cable between them."""
    if os.geteuid() or shutil.which("ip") is None:
        return False
    ground, space = names[Segment.GROUND], names[Segment.SPACE]
    steps: list[tuple[str, ...]] = [("netns", "add", name) for name in names.values()]
    cable = ("-n", ground, "link", "add", "cable", "type", "veth", "peer", "name", "cable")
    steps.append((*cable, "netns", space))
    for segment, name in names.items():
        steps += [
            ("-n", name, "link", "set", "lo", "up"),
            ("-n", name, "address", "add", f"{_ADDRESSES[segment]}/24", "dev", "cable"),
            ("-n", name, "link", "set", "cable", "up"),
        ]
    return all(_ip(*step) for step in steps)


def _ip(*words: str) -> bool:
    if shutil.which("ip") is None:
        return False
    return subprocess.run(["ip", *words], capture_output=True).returncode == 0
