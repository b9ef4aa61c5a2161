"""Input of a session from outside: garbage on its ports, and faulty sources."""

import os
import random
import shutil
import socket
import struct
import time
from dataclasses import replace
from pathlib import Path

import pytest
from common import free_port
from mcap.reader import make_reader
from programs import media_server
from running_session import SMALL, eventually, restarted

from pipelines.session.setup.table import PORTS
from pipelines.table import topology_of


def garbage():
    rng = random.Random(2)
    yield from (b"", b"\x80", bytes(32), b"\xff" * 500)
    yield from (rng.randbytes(length) for length in (1, 12, 28, 32, 501, 1400, 9000, 60_000))
    for payload_type in (96, 97, 96 | 0x80):
        header = struct.pack("!BBHII", 0x80, payload_type, 7, 1234, rng.getrandbits(32))
        yield from (header + payload for payload in (b"", b"\x7c\x85junk", rng.randbytes(300)))
    for packet_type in (200, 202, 205, 206):
        yield struct.pack("!BBHI", 0x81, packet_type, 0xFFFF, 0xDEADBEEF) + rng.randbytes(20)


def test_garbage_is_dropped_and_sources_that_are_silent_or_end_fail_no_session(
    start, footage, speech, tmp_path
):
    fifo, film, voice = (tmp_path / name for name in ("head.y4m", "film.mp4", "voice.wav"))
    os.mkfifo(fifo)
    shutil.copyfile(footage("carphone_pristine.mp4"), film)
    shutil.copyfile(speech("Front_Center.wav"), voice)
    session = start(
        SMALL,
        "--source", f"head=pipe:{fifo}",
        "--source", f"operator_camera={film}",
        "--source", f"ground_mic={voice}",
    )  # fmt: skip
    session.pids()
    session.wait_for_flow()
    datagrams = list(garbage())
    # Haptics in and out at each end, telecommands and telemetry alike.
    eventually(lambda: len([*session.temporary.rglob("port-*")]) == 8, "all sockets")
    own = [path for path in session.temporary.rglob("port-*") if path.is_socket()]
    assert len(own) == 8
    assert {path.parent.stat().st_mode & 0o777 for path in own} == {0o700}
    rows = topology_of(replace(session.setup, base_port=session.base_port)).streams
    media = {port for row in rows if row.sender for port in (row.entry_port, row.exit_port)}
    for port in media:
        # Nobody listens to this sender: the kernel drops what it sends, and tells it so.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unknown:
            unknown.connect(("127.0.0.1", port))
            unknown.send(b"\x80")
            with pytest.raises(ConnectionRefusedError):
                unknown.send(b"\x80")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for index, datagram in enumerate(datagrams):
            for port in range(session.base_port, session.base_port + PORTS):
                udp.sendto(datagram, ("127.0.0.1", port))
            # No flood, because a full socket drops datagrams without a count.
            if index % 4 == 0:
                time.sleep(0.02)
    session.wait_for_flow()
    # A camera without pictures is selected: the encoder waits for one, and no process fails.
    assert session.select("head").returncode == 0
    session.wait_for_flow(["uplink_voice", "downlink_video", "haptic_up", "haptic_down"])
    assert session.select("static").returncode == 0
    session.wait_for_flow()
    for path in (film, voice):
        with path.open("r+b") as file:
            file.truncate(100)
    session.wait_for_flow(["uplink_video", "downlink_voice", "haptic_up", "haptic_down"])
    report = session.finish(silent=True, sound=True)
    for direction, link in report["link"].items():
        # Maintenance is open to any program.
        assert link["refused"]["oversize"] > 0, direction
        assert link["refused"]["garbage"] == link["refused"]["haptic_length"] == 0
    for end, gateway in report["gateways"].items():
        # Only datagrams of the other gateway are parsed.
        assert gateway["unknown_senders"]["radio"] > 0, end
    for name, stream in report["streams"].items():
        assert stream["garbage"] == 0, name
    for name, haptic in report["haptic"].items():
        assert haptic["garbage"] == 0, name
    processes = report["processes"]
    for name in ("console", "selector"):
        assert processes[name]["counts"]["pus_garbage"] == 0, name
    assert restarted(report) == {}
    session.assert_nothing_left()


def test_a_camera_in_the_network_comes_back_and_its_password_is_nowhere(start, tmp_path):
    port, user = free_port(socket.SOCK_STREAM), "bob:S3cret-1"
    shown = f"rtsp://127.0.0.1:{port}/h264"
    with media_server(tmp_path / "1.txt", port, user):
        source = f"head=rtsp://{user}@127.0.0.1:{port}/h264"
        session = start(SMALL, "--source", source, "--record", "a.mcap")
        session.pids()
        assert session.select("head").returncode == 0
        session.wait_for_flow()
    eventually(lambda: f"{shown}: " in (tmp_path / "out.txt").read_text(), "the reason")
    with media_server(tmp_path / "2.txt", port, user):
        session.wait_for_flow()
        for pid in (session.process.pid, *session.pids().values()):
            assert b"S3cret" not in Path(f"/proc/{pid}/cmdline").read_bytes()
        report = session.finish(sound=True)
    camera = report["processes"]["camera_head"]
    assert camera["restarts"] == 0 and camera["counts"]["source_faults"] >= 1
    assert camera["source_fault"].startswith(f"{shown}: ")
    assert camera["dated_by"] in ("source", "arrival")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        kept = b"".join(message.data for *_, message in reader.iter_messages())
        kept += "".join(str(each.metadata) for each in reader.iter_metadata()).encode()
    assert shown.encode() in kept
    written = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(b"S3cret" in octets for octets in (kept, *written))
