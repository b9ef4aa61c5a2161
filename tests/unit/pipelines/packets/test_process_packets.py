"""Frames of the link go to a ground system by UDP."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from kontur_av.errors import ConfigError
from pipelines.link.figures import pack_frames
from pipelines.packets.process_packets import FrameCopies, parse_frames


def test_each_frame_is_a_datagram_and_missed_samples_are_counted():
    numbers, sent = [4, 5, 8, 0, 1], []
    samples = []
    for number in numbers:
        octets = pack_frames([(0, b"one %d" % number), (1, b"two %d" % number)])
        lease = MagicMock(stamp=SimpleNamespace(sequence=number))
        lease.octets.return_value = octets
        samples.append(lease)
    reader = SimpleNamespace(next=lambda: samples.pop(0) if samples else None)
    copies = FrameCopies(reader, SimpleNamespace(send=sent.append))
    copies.copy()
    assert sent[:3] == [b"one 4", b"two 4", b"one 5"]
    assert copies.copied == len(sent) == 10
    # After 8 a gateway was started again.
    assert copies.missed == 2
    assert parse_frames("udp:127.0.0.1:5") == ("127.0.0.1", 5)
    for text in ("127.0.0.1:5", "tcp:5", "udp:5", "udp:a:0", "udp:a:65535"):
        with pytest.raises(ConfigError, match=r"--frames .* write udp:HOST:PORT"):
            parse_frames(text)
