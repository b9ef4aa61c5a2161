"""Requirement: both ends have repair or none, and losses reach the sender."""

from dataclasses import replace
from random import Random

import pytest
from virtual_link import VirtualLink

from telepresence.link.flows import Level, packet_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

S = 1_000_000_000
FLOWS = [packet_flow("tm", Level.TMTC), packet_flow("files", Level.MAINTENANCE)]


class Lossy(RadioPath):
    """Loses a share of the frames."""

    share, random = 0.0, Random(1)

    def handle_frame(self, frame, now_ns):
        if self.random.random() >= self.share:
            super().handle_frame(frame, now_ns)


def joined(*modes, seed=7, start_ns=0):
    """Ground and space with a delay of 100 ms, each with a mode of its own."""
    links = [
        VirtualLink(
            uplink_flows=FLOWS,
            downlink_flows=FLOWS,
            uplink=replace(UPLINK, repair=mode),
            downlink=replace(DOWNLINK, repair=mode),
            up=Lossy(delay_ns=S // 10),
            down=Lossy(delay_ns=S // 10),
            seed=seed,
            start_ns=start_ns,
        )
        for mode in modes
    ]
    links[0].space = links[1].space
    return links[0]


def run(link, seconds):
    for slot in range(int(seconds * 1000)):
        for gateway in (link.ground, link.space):
            gateway.handle_haptic(bytes(12), link.now_ns)
            if slot % 20 == 0:
                gateway.handle_datagram("files", bytes(100), link.now_ns)
        for _ in link.step():
            pass
    return [gateway.report(link.now_ns) for gateway in (link.ground, link.space)]


@pytest.mark.parametrize(
    ("ground", "space", "on"),
    [
        ("auto", "auto", True),
        ("auto", "idle", True),
        ("auto", "off", False),
        ("off", "auto", False),
        ("idle", "off", None),
    ],
)
def test_both_ends_have_repair_or_none(ground, space, on):
    link = joined(ground, space)
    reports = run(link, 6)
    if on is None:
        assert {report.supervision.state for report in reports} == {"refused"}
        assert "repair is on at one end only" in reports[0].supervision.why
        return
    assert {report.supervision.state for report in reports} == {"connected"}
    for report, mode in zip(reports, (ground, space), strict=True):
        assert report.transmit.octets.get("repair", 0) > 0 if on else True
        if mode != "off":
            assert report.transmit.repair_sent.mode == ("idle" if on else "off")
    # With another peer that has repair, it is on again.
    if not on:
        again = joined("auto", "auto", seed=70, start_ns=link.now_ns)
        for name, gateway in (("ground", link.ground), ("space", link.space)):
            if gateway.supervisor.configuration.repair == "auto":
                setattr(again, name, gateway)
        assert {report.supervision.state for report in run(again, 5)} == {"connected"}
        assert again.ground.repair.on and again.space.repair.on


def test_reported_losses_turn_the_reserve_on_and_thirty_seconds_without_end_it():
    link = joined("auto", "auto")
    assert run(link, 3)[0].transmit.repair_sent.mode == "idle"
    link.ground.radio.share = 0.02
    ground, space = run(link, 3)
    assert ground.transmit.repair_sent.mode == "reserve" and link.ground.sender.reserve.after_voice
    assert ground.transmit.repair_sent.lost == pytest.approx(0.02, abs=0.01)
    assert space.transmit.repair_sent.mode == "idle" and space.receive.repaired.zones > 0
    link.ground.radio.share = 0.0
    assert run(link, 29)[0].transmit.repair_sent.mode == "reserve"
    assert run(link, 6)[0].transmit.repair_sent.mode == "idle"


@pytest.mark.parametrize("mode", ["auto", "idle"])
def test_with_a_compact_path_idle_zones_repair_only_while_losses_are_reported(mode):
    link = joined(mode, mode)
    link.ground.repair.set_compact(True)
    ground, space = run(link, 3)
    assert (ground.transmit.octets["repair"], ground.transmit.repair_sent.mode) == (0, "waiting")
    assert space.transmit.octets["repair"] > 0
    link.ground.radio.share = 0.05
    ground, space = run(link, 3)
    assert ground.transmit.octets["repair"] > 0 and space.receive.repaired.zones > 0
    assert ground.transmit.repair_sent.mode == ("reserve" if mode == "auto" else "idle")
    assert (link.ground.sender.reserve.after_voice > 0) == (mode == "auto")
    link.ground.radio.share = 0.0
    repaired = run(link, 35)[0].transmit.octets["repair"]
    assert run(link, 1)[0].transmit.octets["repair"] == repaired
