"""Programs of others at one session: a ground system, a ROS 2 node, Foxglove's client, Prometheus.

    python attached_programs.py PORTS DIRECTORY [TOPIC...]

keeps them for a session of another process. PORTS: JSON. It takes the address for Foxglove on its
standard input, says `data` once each has got something, and ends them at the input's end.
"""

import json
import subprocess
import sys
from pathlib import Path

from foxglove_client import FoxgloveClient
from janus_room import free_port
from prometheus_peer import PrometheusPeer
from ros2_peer import Ros2Peer
from running_session import eventually

from pipelines.ros2.publications import publications_of, sources_of
from pipelines.session.setup.setup_file import load_setup
from pipelines.table import topology_of

PICTURES = "/kontur_av/uplink_video/received"
#: Our processes for them.
OURS = ("packets", "ros2", "foxglove", "metrics")


def free_ports():
    """A port for each."""
    return {name: free_port() for name in OURS}


def options(ports):
    """Those of `stream` that attach all."""
    return (
        *("--packets", f"tcp:{ports['packets']}", "--ros2", str(ports["ros2"])),
        *("--foxglove", str(ports["foxglove"]), "--metrics", str(ports["metrics"])),
    )


class Attached:
    """Those that the session calls or that try again wait for it; `join` starts the others."""

    def __init__(self, ports, directory, topics=(PICTURES,)):
        directory.mkdir()
        self._port, self._directory = ports["packets"], directory
        setup = load_setup("taskboard")
        types = {
            one.topic: one.type
            for one in publications_of(sources_of(topology_of(setup, recorder=True, ros2=True)))
        }
        self._node = Ros2Peer(ports["ros2"], {one: types[one] for one in topics}, directory)
        self._prometheus = PrometheusPeer(directory, ports["metrics"], free_port())
        self.processes = {"ros2": self._node.process, "metrics": self._prometheus.process}

    def join(self, url, *pace):
        """url: for Foxglove's client. pace: its own."""
        self._packets = self._directory / "packets"
        with self._packets.open("wb") as octets:
            read = f"exec cat </dev/tcp/127.0.0.1/{self._port}"
            self.processes["packets"] = subprocess.Popen(["bash", "-c", read], stdout=octets)
        self._client = FoxgloveClient(url, self._directory / "client.txt", *pace)
        self.processes["foxglove"] = self._client.process

    def wait_for_data(self):
        """Each of them gets something."""
        eventually(lambda: self._packets.stat().st_size, "packets")
        eventually(lambda: self._node.heard(PICTURES), "pictures in ROS 2")
        eventually(lambda: self._client.answers("topic"), "messages in Foxglove")
        eventually(lambda: self._prometheus.scraped().get(("up",)), "figures in Prometheus")

    def kill(self):
        for process in self.processes.values():
            process.kill()
            process.wait()


def main(ports, directory, *topics):
    attached = Attached(json.loads(ports), Path(directory), (PICTURES, *topics))
    try:
        print("ready", flush=True)
        attached.join(sys.stdin.readline().strip(), "once")
        attached.wait_for_data()
        print("data", flush=True)
        sys.stdin.read()
    finally:
        attached.kill()


if __name__ == "__main__":
    main(*sys.argv[1:])
