"""The partner's own network: a namespace behind a cable that can be thin, or cut."""

import os
import shutil
import subprocess
from typing import Self

#: Of the network for benchmarks (RFC 2544).
HOST, _PARTNER = "198.19.7.1", "198.19.7.2"
#: A third of what the leg wants to send; and a queue as home routers have it.
_THIN = "rate", "500kbit", "burst", "16kb", "latency", "200ms"


def lacking() -> str:
    """Say in one line why there can be no such network; "" if there can."""
    if os.geteuid():
        return "a network of the partner's own needs root"
    missing = [name for name in ("ip", "tc") if shutil.which(name) is None]
    return f"{', '.join(missing)}: apt-get install iproute2" if missing else ""


class Network:
    """A context manager. prefix: the words before a command of the partner."""

    def __init__(self) -> None:
        self._name, self._cable = f"kav{os.getpid()}-partner", f"kav{os.getpid()}"[:15]
        self.prefix = ("ip", "netns", "exec", self._name)

    def __enter__(self) -> Self:
        name, cable = self._name, self._cable
        try:
            _run("ip", "netns", "add", name)
            _run("ip", "link", "add", cable, "type", "veth", "peer", "eth0", "netns", name)
            _run("ip", "address", "add", f"{HOST}/30", "dev", cable)
            _run("ip", "link", "set", cable, "up")
            _run("ip", "-n", name, "address", "add", f"{_PARTNER}/30", "dev", "eth0")
            _run("ip", "-n", name, "link", "set", "lo", "up")
            _run("ip", "-n", name, "link", "set", "eth0", "up")
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def thin(self) -> None:
        """Let it carry a third of what is sent."""
        _run("tc", "qdisc", "add", "dev", self._cable, "root", "tbf", *_THIN)

    def cut(self) -> None:
        """Let it carry nothing."""
        _run("ip", "-n", self._name, "link", "set", "eth0", "down")

    def _remove(self) -> None:
        subprocess.run(["ip", "netns", "delete", self._name], capture_output=True)


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
