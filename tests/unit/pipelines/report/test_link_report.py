"""What `kontur-av link` shows: rates by the link's own time, and a count of every octet."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from told import message, processes

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.link.link_metrics import SocketMetrics
from pipelines.report import link_report
from pipelines.report.collector import Collector
from pipelines.report.live import LinkLines
from pipelines.report.model import LinkReport, from_json, to_json
from pipelines.report.summary import print_summary
from pipelines.session.session_metrics import LoopMetrics
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.link.gateway import Gateway
from telepresence.link.link_metrics import PeerMetrics

SETUP = BUILT_IN["taskboard"]
ENDS = list(Segment)


def gateway(end, now_ns=0, setup=SETUP):
    session = topology_of(setup)
    ways = [(session.link(one).profile, session.flows(one)) for one in Direction]
    (out, sent), (back, received) = ways if end is Segment.GROUND else ways[::-1]
    return Gateway(
        transmit=out,
        transmit_flows=sent,
        receive=back,
        receive_flows=received,
        master=end is Segment.GROUND,
        boot_id=7,
        now_ns=now_ns,
    )


class Link:
    """Two gateways on virtual time, and the collector that they report to."""

    def __init__(self):
        self.collector = Collector(topology_of(SETUP))
        self.ends = {end: gateway(end) for end in ENDS}
        self.now_ns = 0

    def run(self, slots, offer=lambda ground, space, now_ns: None):
        ground, space = self.ends.values()
        for _ in range(slots):
            offer(ground, space, self.now_ns)
            for one, other in ((ground, space), (space, ground)):
                one.handle_slot(self.now_ns)
                while (frame := one.poll_transmit(self.now_ns)) is not None:
                    other.handle_radio(frame, self.now_ns)
                while other.next_event() is not None:
                    pass
            self.now_ns += NS_PER_MS
        for end, core in self.ends.items():
            gauges = core.report(self.now_ns)
            told = message(LoopMetrics(slips=2, cycles=1000), gauges)
            self.collector.handle_message(f"{end.value}_gateway", told, self.now_ns)

    def report(self, ends=ENDS, **changes):
        names = [f"{end.value}_gateway" for end in ends]
        return link_report.build_link_report(
            self.collector,
            ends,
            seconds=self.now_ns / NS_PER_S,
            seed=3,
            processes=processes(names, 0.5, **changes),
            launcher_cpu_s=0.1,
        )


def summary_of(report):
    console = Console(width=118)
    with console.capture() as capture:
        print_summary(report, console)
    return capture.get()


def haptics(ground, space, now_ns):
    ground.handle_haptic(bytes(12), now_ns)


def test_rates_cover_the_time_since_the_previous_line():
    link, shown = Link(), LinkLines()
    assert shown.lines(link.report())[0].endswith("ground: starting")
    link.run(300)
    assert "haptic 0.0" in shown.lines(link.report())[0]
    link.run(250, haptics)
    ground, space = shown.lines(link.report())
    # 12 octets a millisecond; supervision took no slot.
    assert re.search(r"haptic 96\.0 tmtc 0\.0", ground)
    assert "haptic 0.0" in space
    assert "heard 550 frames, 0 lost, 2 slips" in space
    # A restarted gateway counts from 0.
    link.collector.handle_exit("ground_gateway", "")
    link.ends[Segment.GROUND] = gateway(Segment.GROUND, link.now_ns)
    link.run(100, haptics)
    assert "haptic 96.0" in shown.lines(link.report())[0]


def test_the_summary_shows_the_metrics_of_the_report():
    link = Link()
    link.run(400, haptics)
    told = message(SocketMetrics(unknown_senders={"radio": 4}))
    link.collector.handle_message("ground_gateway", told, link.now_ns)
    report = from_json(to_json(link.report()), LinkReport)
    assert report == link.report()
    for direction, octets in (("uplink", 32), ("downlink", 500)):
        assert report.link[direction].sender.frames == 400
        assert sum(report.link[direction].sender.octets.values()) == 400 * octets
    assert report.gateways["ground"].sockets.unknown_senders == {"radio": 4}
    assert report.failures == []
    text = summary_of(report)
    assert text.startswith("taskboard, 0.4 s   ") and "radio cable" in text.splitlines()[0]
    assert "uplink: 400 frames sent, 2 slips" in text
    ledgers = re.findall(r"of \d+ octets, in %: (.*)", text)
    assert len(ledgers) == 2
    for ledger in ledgers:
        shares = re.findall(r" ([\d.]+)", ledger)
        assert round(sum(map(float, shares)), 6) == 100
    assert "from unknown senders: radio 4" in text


def test_a_refusal_is_shown_with_its_reason_and_one_end_alone_reports_its_half():
    link = Link()
    link.ends[Segment.SPACE] = gateway(Segment.SPACE, setup=BUILT_IN["spacejustin"])
    link.run(100)
    for lines in (LinkLines().lines(link.report()), summary_of(link.report()).splitlines()):
        told = [line for line in lines if "refused (" in line]
        assert len(told) == len(ENDS)
        assert all("give both ends the same setup" in line for line in told)
    link = Link()
    link.run(100)
    del link.collector.processes["space_gateway"]
    fallen = {"restarts": 1, "trouble": "it was started again"}
    report = link.report([Segment.GROUND], ground_gateway=fallen)
    assert list(report.gateways) == ["ground"]
    assert report.link["uplink"].sender.frames == 100
    assert report.link["uplink"].receiver.packets == {}
    assert report.link["downlink"].sender.frames == 0
    text = summary_of(report)
    assert "downlink received: 0 frames lost" in text
    assert "failed: ground_gateway: it was started again" in text


@given(st.dictionaries(st.text(min_size=1, max_size=8), st.integers(0, 10**12), max_size=12))
def test_the_shares_of_the_ledger_add_up_to_exactly_100_percent(octets):
    shares, total = link_report.ledger_percent(octets), sum(octets.values())
    assert sum(round(100 * share) for share in shares.values()) == (10_000 if total else 0)
    assert all(abs(share - 100 * octets[k] / total) < 0.0101 for k, share in shares.items())


@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=lambda setup: setup.name)
def test_the_arithmetic_of_a_direction_adds_up_to_its_capacity(setup):
    for direction, profile in (("uplink", setup.uplink), ("downlink", setup.downlink)):
        lines = link_report.link_metrics(Collector(topology_of(setup)), direction).arithmetic
        assert sum(line.bps for line in lines) == profile.media_bps
        assert (lines[-1].what, lines[-1].bps > 0) == ("spare", True)


def test_a_path_that_carries_less_is_in_the_line_of_the_path():
    counts = dict.fromkeys(("address_changes", "sent", "unsent", "taken"), 0)
    slow = {"path_state": "lower caps", "path_why": "records wait 80 ms", "video_cap_bps": 43_400}
    more = {**counts, **slow, "dropped": {}, "events": []}
    peer = PeerMetrics(begun_ns=0, protected=True, address="192.0.2.1:1", session_ns=1, **more)
    words = "path 192.0.2.1:1, lower caps, video at most 43 kbit/s: records wait 80 ms"
    assert link_report.peer_words(peer) == words
