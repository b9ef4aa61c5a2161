"""Two hosts behind a NAT each, and a public host, as network namespaces of this machine.

    ground 10.1.0.2 -- 10.1.0.1 [NAT] 203.0.113.1 --+
                                                    router -- 203.0.113.254 -- 203.0.113.9 outside
    space  10.2.0.2 -- 10.2.0.1 [NAT] 203.0.113.2 --+

Ground's NAT forwards `PORT` to ground; nothing else comes in from outside. The documentation's
addresses (RFC 5737) stand for the Internet.
"""

import contextlib
import os
import shutil
import subprocess

import pytest

PORT = 27_000
GROUND_PUBLIC, SPACE_PUBLIC, SPACE_MOVED = "203.0.113.1", "203.0.113.2", "203.0.113.3"
OUTSIDE = "203.0.113.9"
_HOSTS = {
    "ground": ("10.1.0.2", "10.1.0.1"),
    "space": ("10.2.0.2", "10.2.0.1"),
    "outside": (OUTSIDE, "203.0.113.254"),
}
_NAT = """
table ip nat {{
  chain in {{
    type nat hook prerouting priority dstnat;
    ip daddr {ground} udp dport {port} dnat to 10.1.0.2
    ip daddr {ground} tcp dport {port} dnat to 10.1.0.2
  }}
  chain out {{
    type nat hook postrouting priority srcnat;
    ip saddr 10.1.0.2 oifname != "to-ground" snat to {ground}
    ip saddr 10.2.0.2 oifname != "to-space" snat to {space}
    ip saddr 10.2.0.3 oifname != "to-space" snat to {moved}
  }}
}}
table ip filter {{
  chain forward {{
    type filter hook forward priority filter; policy drop;
    ct state established,related accept
    ct status dnat accept
    iifname "to-ground" ip daddr 203.0.113.0/24 accept
    iifname "to-space" ip daddr 203.0.113.0/24 accept
  }}
}}
"""


class TwoHosts:
    """The namespaces, from `with` to its end. Skips the test where the machine forbids them."""

    def __init__(self):
        self._names = {name: f"kav{os.getpid()}-{name}" for name in ("router", *_HOSTS)}

    def __enter__(self):
        if os.geteuid() or not (shutil.which("ip") and shutil.which("nft")):
            pytest.skip("network namespaces need root, ip(8) and nft(8)")
        with contextlib.ExitStack() as stack:
            stack.callback(self._remove)
            try:
                self._make()
            except subprocess.CalledProcessError as error:
                pytest.skip(f"this machine forbids network namespaces: {error.stderr.strip()}")
            stack.pop_all()
        return self

    def __exit__(self, *_):
        self._remove()

    def prefix(self, host):
        """Return the words before a command that is to run on a host."""
        return ("ip", "netns", "exec", self._names[host])

    def move_space(self):
        """Give space another address, inside and outside, as a change of network does."""
        at = "-n", self._names["space"]
        # The route goes with the old address.
        _run("ip", *at, "address", "delete", "10.2.0.2/24", "dev", "eth0")
        _run("ip", *at, "address", "add", "10.2.0.3/24", "dev", "eth0")
        _run("ip", *at, "route", "add", "default", "via", "10.2.0.1")

    def cut(self, host):
        """Take a host's cable out."""
        _run("ip", "-n", self._names["router"], "link", "set", f"to-{host}", "down")

    def fix(self, host):
        """Put it in again."""
        _run("ip", "-n", self._names["router"], "link", "set", f"to-{host}", "up")

    def _make(self):
        for name in self._names.values():
            _run("ip", "netns", "add", name)
            _run("ip", "-n", name, "link", "set", "lo", "up")
        router = self._names["router"]
        for host, (address, gateway) in _HOSTS.items():
            at = "-n", self._names[host]
            _run(
                *("ip", "-n", router, "link", "add", f"to-{host}", "type", "veth"),
                *("peer", "name", "eth0", "netns", self._names[host]),
            )
            _run("ip", "-n", router, "address", "add", f"{gateway}/24", "dev", f"to-{host}")
            _run("ip", "-n", router, "link", "set", f"to-{host}", "up")
            _run("ip", *at, "address", "add", f"{address}/24", "dev", "eth0")
            _run("ip", *at, "link", "set", "eth0", "up")
            _run("ip", *at, "route", "add", "default", "via", gateway)
        for public in (GROUND_PUBLIC, SPACE_PUBLIC, SPACE_MOVED):
            _run("ip", "-n", router, "address", "add", f"{public}/32", "dev", "to-outside")
        _run("ip", "netns", "exec", router, "sysctl", "-qw", "net.ipv4.ip_forward=1")
        rules = _NAT.format(ground=GROUND_PUBLIC, space=SPACE_PUBLIC, moved=SPACE_MOVED, port=PORT)
        _run("ip", "netns", "exec", router, "nft", "-f", "-", text=rules)

    def _remove(self):
        for name in self._names.values():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)


def _run(*words, text=None):
    subprocess.run(words, input=text, text=True, capture_output=True, check=True)
