"""Frames of the link go to a ground system by UDP."""

import socket
from contextlib import ExitStack
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
from common import eventually

from kontur_av.errors import ConfigError
from pipelines.packets.process_packets import FrameCopies, _Streams, parse_frames
from pipelines.session.topic import Topic
from pipelines.session.topology.rows import Frames

FRAMES = Topic("frames", Frames, "frames")


def test_each_frame_is_a_datagram_and_missed_samples_are_counted():
    numbers, sent = [4, 5, 8, 0, 1], []
    samples = []
    for number in numbers:
        octets = FRAMES.pack([(0, b"one %d" % number), (1, b"two %d" % number)])
        lease = MagicMock(stamp=SimpleNamespace(sequence=number))
        lease.octets.return_value = octets
        samples.append(lease)
    reader = SimpleNamespace(next=lambda: samples.pop(0) if samples else None)
    copies = FrameCopies(reader, FRAMES, SimpleNamespace(send=sent.append))
    copies.copy()
    assert sent[:3] == [b"one 4", b"two 4", b"one 5"]
    assert copies.copied == len(sent) == 10
    # After 8 a gateway was started again.
    assert copies.missed == 2
    assert parse_frames("udp:127.0.0.1:5") == ("127.0.0.1", 5)
    for text in ("127.0.0.1:5", "tcp:5", "udp:5", "udp:a:0", "udp:a:65535"):
        with pytest.raises(ConfigError, match=r"--frames .* write udp:HOST:PORT"):
            parse_frames(text)


def test_idle_peers_keep_no_other_out_and_one_that_sends_no_more_gets_packets():
    with ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        listener.setblocking(False)
        streams, bridge, now_ns = _Streams(listener), MagicMock(), [0]
        stack.callback(streams.close)

        def joined(count):
            """As many that are taken one after the other."""
            found = []
            for _ in range(count):
                tcp = socket.create_connection(listener.getsockname(), 9)
                found.append(stack.enter_context(tcp))
                before = bridge.handle_connection.call_count
                eventually(lambda: turn() or bridge.handle_connection.call_count > before)  # noqa: B023
            return found

        def turn():
            now_ns[0] += 1
            streams.read(bridge, now_ns[0])
            streams.write(bridge, now_ns[0])

        idle = joined(8)
        reader, *_ = joined(8)
        assert [one.recv(1) for one in idle] == [b""] * 8
        reader.sendall(b"\x18\0\xc0\0\0\0\0")
        eventually(lambda: turn() or bridge.handle_command.called)
        reader.shutdown(socket.SHUT_WR)
        # It would wake the process all the time.
        eventually(lambda: turn() or len(streams.descriptors) == 8)
        streams.put(b"packet", now_ns[0])
        turn()
        assert reader.recv(9) == b"packet"
        reader.close()

        def gone():
            streams.put(b"packet", now_ns[0])
            turn()
            return len(streams._peers) == 7

        eventually(gone)
