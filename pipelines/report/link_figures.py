"""The link in a report: each direction with its ledger, and what its two ends observed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import TypeVar

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.figures import plus
from kontur_av.meters import Histogram
from pipelines.link.figures import SocketFigures, WayInFigures
from pipelines.report.collector import Collector
from pipelines.report.model import (
    DirectionReport,
    GatewayReport,
    LineReport,
    NeedReport,
    Punctuality,
)
from pipelines.session.figures import LoopFigures
from pipelines.session.setup.table import Setup
from pipelines.session.topology import Direction, Segment
from telepresence.link.figures import ReceiverFigures, SenderFigures
from telepresence.link.peer.figures import PeerFigures
from telepresence.link.profile import LinkProfile

RecordT = TypeVar("RecordT")


def link_figures(setup: Setup, collector: Collector, direction: str) -> DirectionReport:
    """One direction of the link, from what its two gateways have reported."""
    up = direction == "uplink"
    link = collector.topology.link(Direction(direction))
    near, far = collector.process(link.sender), collector.process(link.receiver)
    sent = _all_lives(SenderFigures(), [life.transmit for life in near.links()])
    received = _all_lives(ReceiverFigures(), [life.receive for life in far.links()])
    need = setup.need_up() if up else setup.need_down()
    profile = setup.uplink if up else setup.downlink
    return DirectionReport(
        # Known even if the sender is on another machine.
        sender=replace(sent, capacity_bps=profile.capacity_bps),
        receiver=received,
        below_haptics_bps=profile.media_bps,
        needed_at_caps_bps=NeedReport(
            payload=need.payload_bps,
            headers=need.overhead_bps,
            reserve=need.reserve_bps,
            spare=need.spare_bps,
        ),
        arithmetic=[
            LineReport(what=line.what, stream=line.stream, bps=line.bps)
            for line in setup.channel_table(link.direction)
        ],
        freed_bps=_freed_bps(profile, sent),
        octets_percent=ledger_percent(sent.octets),
        lateness_us=punctuality_us(near.lateness),
        sent_after_us=punctuality_us(near.sending),
        loop=near.total(LoopFigures),
    )


def _all_lives(nothing: RecordT, lives: Sequence[RecordT]) -> RecordT:
    return reduce(plus, lives[1:], lives[0]) if lives else nothing


def _freed_bps(profile: LinkProfile, sent: SenderFigures) -> int:
    """The rate (bit/s) that slots without a sample left to the levels below haptics."""
    freed_octets = sent.frames * profile.insert_octets - sent.octets.get("haptic", 0)
    return round(freed_octets * 8 * NS_PER_S / max(sent.frames * profile.slot_ns, 1))


def ledger_percent(octets: Mapping[str, int]) -> dict[str, float]:
    """The shares of all octets in percent, to two digits; they sum to 100.00 exactly.

    All shares are rounded down. The missing hundredths go to those that lost most by it.
    """
    total = sum(octets.values())
    if not total:
        return {}
    shares = {kind: divmod(10_000 * count, total) for kind, count in octets.items()}
    left = 10_000 - sum(whole for whole, _ in shares.values())
    losers = sorted(shares, key=lambda kind: shares[kind][1], reverse=True)[:left]
    return {kind: (whole + (kind in losers)) / 100 for kind, (whole, _) in shares.items()}


def gateway_figures(collector: Collector, end: str) -> GatewayReport:
    """What only this end knows: the link of its last life, and its sockets."""
    figures = collector.process(collector.topology.gateway(Segment(end)).name)
    last = next(reversed(list(figures.links())), None)
    return GatewayReport(
        supervision=None if last is None else last.supervision,
        radio=None if last is None else last.radio,
        sockets=figures.total(SocketFigures),
        clock=None if last is None else last.clock,
        peer=figures.find(PeerFigures),
        way_in=figures.find(WayInFigures),
    )


def peer_words(figures: PeerFigures) -> str:
    """The state of the path to the other machine, in a few words."""
    found = figures.address or "nobody has called"
    words = f"{'no session' if figures.session_ns is None else 'path'} {found}"
    dropped = sum(figures.dropped.values())
    if dropped:
        reason = max(figures.dropped, key=lambda name: figures.dropped[name])
        words += f", {dropped} datagrams dropped (most: {reason})"
    return words if figures.protected else f"NOT PROTECTED, {words}"


def punctuality_us(histogram: Histogram) -> Punctuality:
    """Percentiles of values in ns, in µs."""
    summary = histogram.summary_ms()
    return Punctuality(
        p50=round(summary["p50"] * 1000, 1),
        p95=round(summary["p95"] * 1000, 1),
        p99=round(summary["p99"] * 1000, 1),
        max=round(summary["max"] * 1000, 1),
        p99_9=round(histogram.percentile(99.9) / NS_PER_US, 1),
    )
