"""The model of a network on virtual time, alone and under two protected ends."""

import pytest
from protected_pair import GROUND_ADDRESS, GROUND_KEY, SPACE_ADDRESS, SPACE_KEY

from telepresence.link.frame import FrameCodec
from telepresence.link.path.bundles import Bundling
from telepresence.link.peer_path import ProtectedPath
from telepresence.link.profile import DOWNLINK
from telepresence.link.radio.network import Network, NetworkPath

MS = 1_000_000


def carried(path, slots=20_000):
    """A datagram of 100 octets a slot; returns (slot sent, slot arrived)."""
    arrived = []
    for slot in range(slots + 200):
        if slot < slots:
            path.handle_datagram(slot.to_bytes(100, "big"), slot * MS)
        while (datagram := path.poll_transmit(slot * MS)) is not None:
            arrived.append((int.from_bytes(datagram, "big"), slot))
    return arrived


def test_the_conditions_hold_and_a_seed_repeats_them():
    bad = Network(delay_ms=20, loss=0.02, reordered=0.05, reorder_ms=8, repeated=0.01)
    path = NetworkPath(bad, seed=3)
    arrived = carried(path)
    assert arrived == carried(NetworkPath(bad, 3)) != carried(NetworkPath(bad, 4))
    shares = [number / path.sent for number in (path.lost, path.reordered, path.repeated)]
    assert shares == pytest.approx([0.02, 0.05, 0.01], rel=0.2)
    assert len(arrived) == path.sent - path.lost + path.repeated
    assert {came - sent for sent, came in arrived} == set(range(20, 29))
    uneven = carried(NetworkPath(Network(jitter_ms=9)), 2000)
    assert [sent for sent, _ in uneven] == list(range(2000))
    path = NetworkPath(Network(loss=0.05, burst_ms=10), seed=2)
    there = {sent for sent, _ in carried(path)}
    assert path.lost / path.sent == pytest.approx(0.05, rel=0.3)
    assert path.lost >= 9 * sum(n not in there and n - 1 in there for n in range(1, 20_000))
    path = NetworkPath(Network(rate_kbps=512, queue_octets=5000))
    assert len(carried(path, 2000)) == 2000 - path.overflows == pytest.approx(1000, abs=60)
    assert 70 * MS < path.most_queued_ns <= 79 * MS


@pytest.mark.parametrize("compact", [False, True])
def test_frames_pass_a_bad_network_in_order_and_octet_for_octet(compact):
    codec, bundling = FrameCodec(DOWNLINK), Bundling(DOWNLINK, DOWNLINK, 2, compact)
    bad = Network(delay_ms=10, loss=0.01, reordered=0.05, reorder_ms=6)
    more = {"secret": bytes(32), "now_ns": 0, "bundling": bundling}
    space = ProtectedPath(SPACE_KEY, GROUND_KEY.identity, address=GROUND_ADDRESS, **more)
    ground = ProtectedPath(GROUND_KEY, SPACE_KEY.identity, address=None, **more)
    ways = [NetworkPath(bad, seed) for seed in (1, 2)]
    sent, got = [], []
    for now_ns in range(0, 4000 * MS, MS):
        count, sample = len(sent), bytes(12) if len(sent) % 3 else None
        zone = bytes(98).ljust(490 if sample is None else 478, b"!")
        content = count % 5 == 0
        sent.append(
            codec.pack(count, sample, 2046, zone) if content else codec.pack_idle(count, sample)
        )
        sealed = space.seal(sent[-1], now_ns)
        for end, out, back, source in (
            (space, *ways, GROUND_ADDRESS),
            (ground, *ways[::-1], SPACE_ADDRESS),
        ):
            while end.handle_rest(now_ns, now_ns + MS):
                pass
            while sealed is not None or (sealed := end.poll_transmit()) is not None:
                out.handle_datagram(sealed[0], now_ns)
                sealed = None
            frames = [end.next_frame(now_ns)]
            while (datagram := back.poll_transmit(now_ns)) is not None:
                frames.append(end.handle_datagram(datagram, source, now_ns))
                frames += iter(lambda path=end, now_ns=now_ns: path.next_frame(now_ns), None)
            got += filter(None, frames)
    counts = [int.from_bytes(frame[2:5], "big") for frame in got]
    assert got == [sent[count] for count in counts]
    assert counts == sorted(set(counts))
    report, of_space = ground.report(now_ns), space.report(now_ns)
    assert report.frames_put_back > 50 and 0 < report.order_budget_ns < 9 * MS
    assert len(counts) > 0.97 * (4000 - counts[0])
    assert (of_space.octets_sent < 4000 * 300) == of_space.compact == compact
