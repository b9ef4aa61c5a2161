"""Copies of frames: where they go, what was missed, and the links of YAMCS that take them."""

import re
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from kontur_av.errors import ConfigError
from pipelines.link.figures import pack_frames
from pipelines.packets.process_packets import FrameCopies, parse_frames
from pipelines.packets.yamcs import instance_files


class Batches:
    """A reader of samples of frames, by number."""

    def __init__(self, *numbers):
        self._numbers = [*numbers]

    def next(self):
        if not self._numbers:
            return None
        number = self._numbers.pop(0)
        octets = pack_frames([(0, b"one %d" % number), (1, b"two %d" % number)])
        lease = MagicMock(stamp=SimpleNamespace(sequence=number))
        lease.octets.return_value = octets
        return lease


def test_each_frame_is_a_datagram_and_missed_samples_are_counted():
    sent = []
    copies = FrameCopies(Batches(4, 5, 8, 0, 1), SimpleNamespace(send=sent.append))
    copies.copy()
    assert sent[:3] == [b"one 4", b"two 4", b"one 5"]
    assert copies.copied == len(sent) == 10
    # After 8 a gateway was started again.
    assert copies.missed == 2


@pytest.mark.parametrize("text", ["127.0.0.1:5", "tcp:5", "udp:5", "udp:a:0", "udp:a:65535"])
def test_frames_go_by_udp_to_two_ports(text):
    assert parse_frames("udp:127.0.0.1:5") == ("127.0.0.1", 5)
    with pytest.raises(ConfigError, match=r"--frames .* write udp:HOST:PORT"):
        parse_frames(text)


def test_yamcs_takes_each_virtual_channel_of_both_ways():
    def links(frames_port):
        files = instance_files("", ("here", 5), udp=False, frames_port=frames_port, http_port=8090)
        return files["etc/yamcs.kontur_av.yaml"].split("  - name: session")[1]

    assert "UdpTmFrameLink" not in links(None)
    down, up = links(7).split("  - name: ")[1:]
    for text, values in (
        (down, {"port": ["7"], "spacecraftId": ["76"], "frameLength": ["500"], "vcId": ["1"]}),
        (up, {"port": ["8"], "frameLength": ["32"], "vcId": [str(one) for one in range(32)]}),
    ):
        for name, expected in values.items():
            assert re.findall(rf"{name}: (\w+)", text) == expected
