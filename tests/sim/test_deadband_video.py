"""Capacity that left-out samples give to the picture: never more than is really free."""

from dataclasses import dataclass, field, replace
from random import Random

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpIdentity
from pipelines.media.gain import LinkedVideoSender, gain_of
from pipelines.media.stream_figures import Outgoing, video_sender
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Direction
from pipelines.table import topology_of
from pipelines.virtual.simulate import simulate
from telepresence.link.flows import Level
from telepresence.link.gateway import Gateway

SETUP = replace(BUILT_IN["spacejustin"], deadband="picture")
STREAM = SETUP.uplink_video
SAMPLE = bytes(12)
CODING_NS = 6 * NS_PER_MS
FREED_BITS = 8 * SETUP.uplink.insert_octets


@dataclass
class Ground:
    """A gateway and a video sender that always has more than its cap to send.

    left: (instant, octets, cap at that instant). free: the slots without a sample.
    """

    left: list = field(default_factory=list)
    free: list = field(default_factory=list)

    def __post_init__(self):
        self.gateway = Gateway(
            transmit=SETUP.uplink,
            transmit_flows=topology_of(SETUP).flows(Direction.UPLINK),
            receive=SETUP.downlink,
            receive_flows=topology_of(SETUP).flows(Direction.DOWNLINK),
            master=True,
            life=1,
            now_ns=0,
        )
        # Simulates a peer that is heard; no real one is needed.
        self.gateway.sender.set_patience(None)
        self.random = Random(1)
        self.sender = video_sender(SETUP, STREAM, RtpIdentity(1, 2, 3), wall_offset_ns=0)
        self.linked = LinkedVideoSender(self.sender, gain_of(SETUP, STREAM))
        self.outgoing = Outgoing(self.sender, Probe(), self.handle_rtp, lambda *_: None)

    def handle_rtp(self, packet, now_ns):
        self.left.append((now_ns, len(packet) - RTP_HEADER_OCTETS))
        self.gateway.handle_datagram("uplink_video", packet, now_ns)

    def run(self, pattern, seconds):
        """pattern(slot): whether the slot has a sample."""
        gateway, sender, linked = self.gateway, self.sender, self.linked
        ready_ns, cap_bps = None, STREAM.cap_bps
        for slot in range(seconds * 1000):
            now_ns = slot * NS_PER_MS
            if pattern(slot):
                gateway.handle_haptic(SAMPLE, now_ns)
            else:
                self.free.append(slot)
            gateway.handle_slot(now_ns)
            while gateway.poll_transmit(now_ns) is not None:
                pass
            if slot % 4 == 0:
                freed_bps = gateway.freed_bps // 1000 * 1000
                waiting = gateway.sender.waiting_octets(Level.VIDEO)
                linked.handle_freed(freed_bps, now_ns)
                sender.handle_channel(waiting, now_ns, contacts=0, way_back=True)
            if slot % 33 == 0:
                stamp = CaptureStamp(now_ns, slot, "test")
                sender.handle_picture(stamp, now_ns)
            if ready_ns is None:
                coding = linked.poll_encode(now_ns)
                if coding is not None:
                    ready_ns = now_ns + CODING_NS
                    cap_bps = coding.cap_bps or cap_bps
            elif now_ns >= ready_ns:
                ready_ns = None
                octets = round(cap_bps / 240 * self.random.uniform(0.7, 1.5))
                nal = b"\0\0\0\1\x41" + b"\x55" * octets
                sender.handle_access_unit(AccessUnit(nal, stamp, False), now_ns)
            self.outgoing.handle_time(now_ns)
        return self

    def octets_in(self, begin_s, end_s):
        return sum(n for at_ns, n in self.left if begin_s * NS_PER_S <= at_ns < end_s * NS_PER_S)


def most_above_bits(ground):
    """Return the largest excess in any sliding second over the cap and the freed capacity."""
    times = np.array([at_ns for at_ns, _ in ground.left])
    sums = np.concatenate([[0], np.cumsum([8 * octets for _, octets in ground.left])])
    free = np.array(ground.free, dtype=np.int64) * NS_PER_MS
    first = np.searchsorted(times, times - NS_PER_S, side="right")
    sent = sums[1:] - sums[first]
    freed = np.searchsorted(free, times, side="right") - np.searchsorted(
        free, times - NS_PER_S, side="right"
    )
    return (sent - STREAM.cap_bps - FREED_BITS * freed).max()


@pytest.mark.parametrize(
    "pattern",
    [
        lambda slot: slot % 6 == 0 or slot % 5000 < 900,
        lambda slot: slot % 6 == 0 or slot % 400 < 60,
        lambda slot: slot < 11_000 and slot % 6 != 0,
        lambda slot: slot >= 9000,
        # Just enough for a step, and then nothing.
        lambda slot: slot % 3 == 0 or slot >= 9000,
        lambda slot: Random(slot // 700).random() < Random(slot).random(),
        lambda slot: True,
    ],
)
def test_no_sliding_second_exceeds_the_cap_and_the_freed_capacity(pattern):
    ground = Ground().run(pattern, 20)
    assert most_above_bits(ground) <= 0
    assert ground.octets_in(10, 20) > 0.8 * STREAM.cap_bps / 8 * 10


def test_a_whole_session_gains_and_reports_it():
    setup = replace(BUILT_IN["taskboard"], radio="clean")
    plain = simulate(setup, seconds=6.0, seed=1)
    saving = simulate(replace(setup, deadband="picture"), seconds=6.0, seed=1)
    assert saving.failures == plain.failures == []
    video, before = (report.streams["uplink_video"] for report in (saving, plain))
    assert video.gained_bps > 15_000 and before.gained_bps is None
    assert video.payload_bps_mean > before.payload_bps_mean + 5_000
    # The channel is faster by what is saved, and pictures do not grow by more than that.
    assert video.latency_ms.p50 < before.latency_ms.p50
    up = saving.haptic["up"]
    assert up.saved_bps > 60_000 and up.receiver.lost == 0
    # Before the session of samples begins, each cycle greets; the first greetings have no signal.
    assert 5980 <= up.sender.sent + up.sender.left_out + up.receiver.greetings <= 6000
    freed_bps = saving.link["uplink"].freed_bps
    assert freed_bps == pytest.approx(up.saved_bps, rel=0.01)
    assert plain.link["uplink"].freed_bps < 100


def test_freed_capacity_can_reduce_the_latency_instead():
    setup = replace(BUILT_IN["spacejustin"], radio="clean")
    reports = (
        simulate(replace(setup, deadband=deadband), seconds=6.0, seed=1)
        for deadband in ("off", "picture", "latency")
    )
    plain, larger, sooner = (report.streams["uplink_video"] for report in reports)
    assert sooner.gained_bps == 0
    assert sooner.payload_bps_mean == pytest.approx(plain.payload_bps_mean, rel=0.05)
    # Slots without a sample carry twice as much: a picture takes little more than half the time.
    assert sooner.latency_ms.p50 < plain.latency_ms.p50 - 8.0
    assert sooner.latency_ms.p99 < larger.latency_ms.p99 - 2.0
