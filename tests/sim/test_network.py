"""Whole sessions over a network between two machines, on virtual time."""

import pytest

from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.simulate import simulate
from telepresence.link.radio import load_radio

SECONDS = 6


def over(radio, **more):
    changes = {"radio": radio, **more}
    setup = load_setup("spacejustin", changes=changes)
    return simulate(setup, seconds=SECONDS, seed=5)


@pytest.fixture(scope="module")
def lte():
    return over(load_radio("lte"))


def test_all_streams_come_through_a_phone_network_from_the_first_second_on(lte):
    streams, peers = lte.streams, [gateway.peer for gateway in lte.gateways.values()]
    for name, shown in (("uplink_video", 0.95), ("downlink_video", 0.98)):
        stream = streams[name]
        # A tenth of a second is left to the first handshake.
        assert stream.display.frames_displayed > shown * (stream.sender.frames_encoded - 10), name
    for name in ("uplink_voice", "downlink_voice"):
        assert streams[name].display.frames_displayed >= 0.98 * (50 * SECONDS - 20), name
    for peer in peers:
        assert peer.protected and peer.sessions == 1 and peer.frames_put_back > 0
        assert peer.octets_sent > 0.9 * SECONDS * 86 * 1000
    assert over(load_radio("lte")) == lte


def test_compact_datagrams_carry_the_same_for_fewer_octets(lte):
    compact = over(load_radio("lte"), path="compact", path_batch_ms=4)
    assert compact.streams["uplink_video"].display.frames_displayed > 0.9 * 25 * SECONDS
    for name, share in (("ground", 0.7), ("space", 0.8)):
        sent = [report.gateways[name].peer.octets_sent for report in (compact, lte)]
        assert sent[0] < share * sent[1], name
