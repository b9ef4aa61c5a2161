"""Programs without knowledge of the link use it: GStreamer, and two network namespaces."""

import contextlib
import ctypes
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import threading
from pathlib import Path

import pytest
from places import ROOT
from running_link import RunningLink, assert_books_are_right, came, eventually

from pipelines.session.setup.setup_file import BUILT_IN

pytestmark = pytest.mark.interop

WIDTH, HEIGHT = 160, 120
FRAME_OCTETS = WIDTH * HEIGHT * 3 // 2
_CLONE_NEWNET = 0x4000_0000


def needs(*elements):
    if shutil.which("gst-launch-1.0") is None:
        pytest.skip("gst-launch-1.0 is missing: install gstreamer1.0-tools")
    for element in elements:
        if subprocess.run(["gst-inspect-1.0", "--exists", element], check=False).returncode:
            pytest.skip(f"GStreamer has no {element}")


@contextlib.contextmanager
def gst(text, log):
    """Run `gst-launch-1.0 -e` with a pipeline; Ctrl-C ends it as it ends the user's."""
    with log.open("w") as out:
        process = subprocess.Popen(
            ["gst-launch-1.0", "-e", *text.split()], stdout=out, stderr=subprocess.STDOUT
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(10)
            if process.poll() is None:
                process.kill()
            process.wait()


def test_gstreamer_sends_video_up_and_receives_it_complete(tmp_path):
    needs("x264enc", "rtph264pay", "rtph264depay", "avdec_h264", "udpsink")
    with RunningLink("--setup", "taskboard", directory=tmp_path) as link:
        entry, out = (
            link.topology.entry_port("uplink_video"),
            link.topology.exit_port("uplink_video"),
        )
        raw = tmp_path / "out.i420"
        receive = (
            f"udpsrc port={out} address=127.0.0.1 "
            "caps=application/x-rtp,media=video,encoding-name=H264,clock-rate=90000,payload=96 "
            "! rtph264depay ! avdec_h264 ! videoconvert ! video/x-raw,format=I420 "
            f"! filesink buffer-mode=unbuffered location={raw}"
        )
        send = (
            "videotestsrc is-live=true pattern=ball "
            f"! video/x-raw,width={WIDTH},height={HEIGHT},framerate=15/1 "
            "! x264enc tune=zerolatency bitrate=50 key-int-max=15 "
            "! rtph264pay pt=96 mtu=1000 config-interval=-1 "
            f"! udpsink host=127.0.0.1 port={entry}"
        )
        link.wait_for_line("ground approve")
        with gst(receive, tmp_path / "receive.txt"), gst(send, tmp_path / "send.txt") as sender:

            def decoded():
                assert sender.poll() is None, (tmp_path / "send.txt").read_text()
                return raw.exists() and raw.stat().st_size // FRAME_OCTETS >= 45

            eventually(decoded, "45 decoded pictures")
        code, report = link.interrupt()
    assert code == 0, link.output()
    up = report["link"]["uplink"]
    assert up["packets"]["uplink_video"] >= 45
    assert up["refused"]["garbage"] == 0
    assert up["octets"]["video"] > 0
    assert_books_are_right(report, BUILT_IN["taskboard"])


def pipelines_of(document):
    """Every `gst-launch-1.0` line of a document, without the command's name."""
    text = (ROOT / document).read_text(encoding="utf-8").replace("\\\n", " ")
    found = re.findall(r"^gst-launch-1\.0 (.*?)\s*&?$", text, re.MULTILINE)
    return [" ".join(shlex.split(line)) for line in found]


@pytest.mark.parametrize("document", ["README.md", "docs/gateways.md"])
def test_the_documents_example_shows_a_picture_to_a_late_receiver(document, tmp_path):
    needs("x264enc", "rtph264pay", "rtph264depay", "avdec_h264", "udpsink")
    (send,) = (line for line in pipelines_of(document) if "port=27010" in line)
    (receive, *_) = (
        line for line in pipelines_of("docs/gateways.md") if "udpsrc port=27012" in line
    )
    raw = tmp_path / "out.i420"
    with RunningLink("--setup", "spacejustin", "--radio", "cable", directory=tmp_path) as link:
        entry = link.topology.entry_port("uplink_video")
        out = link.topology.exit_port("uplink_video")
        send = send.replace("port=27010", f"port={entry}")
        receive = receive.replace("port=27012", f"port={out}")
        assert receive.endswith("! autovideosink")
        receive = receive.replace(
            "autovideosink", f"filesink buffer-mode=unbuffered location={raw}"
        )
        link.wait_for_line("ground approve")
        with gst(send, tmp_path / "send.txt") as sender:
            # For some seconds there is no receiver: the first key pictures are gone.
            for _ in range(4):
                link.wait_for_line("ground")
            with gst(receive, tmp_path / "receive.txt"):

                def shown():
                    assert sender.poll() is None, (tmp_path / "send.txt").read_text()
                    return raw.exists() and raw.stat().st_size >= 320 * 240 * 3 // 2

                eventually(shown, "a picture")
        code, _ = link.interrupt()
    assert code == 0, link.output()


@pytest.fixture
def namespaces():
    """Return two network namespaces with a cable between them, and their addresses."""
    if os.geteuid() or shutil.which("ip") is None:
        pytest.skip("network namespaces need root and iproute2")
    names = [f"kav{end}{os.getpid()}" for end in "gs"]
    addresses = ["10.107.0.1", "10.107.0.2"]
    commands = [
        *(f"netns add {name}" for name in names),
        f"-n {names[0]} link add cable type veth peer name cable netns {names[1]}",
    ]
    for name, address in zip(names, addresses, strict=True):
        commands.append(f"-n {name} addr add {address}/24 dev cable")
        commands += [f"-n {name} link set {device} up" for device in ("lo", "cable")]
    try:
        for command in commands:
            done = subprocess.run(["ip", *command.split()], capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"network namespaces are not permitted here: {done.stderr.strip()}")
        yield dict(zip(names, addresses, strict=True))
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def socket_in(namespace):
    """Return a UDP socket of a namespace; a socket belongs to the namespace of its thread."""
    made = []

    def make():
        with Path(f"/run/netns/{namespace}").open() as file:
            assert ctypes.CDLL(None).setns(file.fileno(), _CLONE_NEWNET) == 0
        made.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))

    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    made[0].setblocking(False)
    return made[0]


def test_two_gateways_without_protection_in_two_network_namespaces(namespaces, tmp_path):
    (ground_name, ground_host), (space_name, _) = namespaces.items()
    base = 27_000
    with contextlib.ExitStack() as stack:

        def start(end, name, *where):
            return stack.enter_context(
                RunningLink(
                    *("--setup", "spacejustin", "--end", end, *where, "--insecure"),
                    directory=tmp_path,
                    name=end,
                    prefix=("ip", "netns", "exec", name),
                    base_port=base,
                )
            )

        ground = start("ground", ground_name, "--listen", f"{ground_host}:{base}")
        space = start("space", space_name, "--peer", f"{ground_host}:{base}")
        session = ground.topology
        on_ground = [stack.enter_context(socket_in(ground_name)) for _ in range(3)]
        in_space = [stack.enter_context(socket_in(space_name)) for _ in range(3)]
        on_ground[1].bind(("127.0.0.1", session.exit_port("downlink_maintenance")))
        in_space[1].bind(("127.0.0.1", session.exit_port("uplink_maintenance")))
        on_ground[2].bind(("127.0.0.1", session.exit_port("downlink_haptic")))
        in_space[2].bind(("127.0.0.1", session.exit_port("uplink_haptic")))

        def through(sender, port, receiver, data):
            for link in (ground, space):
                assert link.process.poll() is None, link.output()
            sender.sendto(data, ("127.0.0.1", port))
            return data in came(receiver)

        ways = (
            (on_ground[0], session.entry_port("uplink_maintenance"), in_space[1], b"up"),
            (in_space[0], session.entry_port("downlink_maintenance"), on_ground[1], b"down"),
            (
                on_ground[0],
                session.entry_port("uplink_haptic"),
                in_space[2],
                b"force sample",
            ),
            (
                in_space[0],
                session.entry_port("downlink_haptic"),
                on_ground[2],
                b"hand command",
            ),
        )
        for way in ways:
            eventually(lambda way=way: through(*way), f"{way[3]!r}")
        # From the peer's machine, but not from its port.
        in_space[0].sendto(bytes(32), (ground_host, base))
        eventually(lambda: through(*ways[1]), "a packet behind the stranger")
        reports = {}
        for link in (ground, space):
            link.wait_for_line("NOT PROTECTED")
            code, report = link.interrupt()
            reports[link.name] = report
            assert code == 0, link.output()
            assert report["failures"] == []
            assert "not_protected" in [warning["what"] for warning in report["warnings"]]
            assert_books_are_right(report, BUILT_IN["spacejustin"])
        assert reports["ground"]["gateways"]["ground"]["peer"]["dropped"] == {"stranger": 1}
        assert report["link"]["uplink"]["packets"]["uplink_maintenance"] > 0
