"""The link in a report: each direction with its ledger, and what its two ends observed."""

from collections.abc import Mapping
from dataclasses import replace

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from pipelines.report.collector import Collector
from pipelines.report.model import (
    DirectionReport,
    GatewayReport,
    LineReport,
    NeedReport,
    PeerEventReport,
    PeerReport,
    Punctuality,
    RadioReport,
)
from pipelines.session.figures import GatewayCounters, LoopCounters, PeerGauges
from pipelines.session.setup.table import Setup
from pipelines.session.topology import Direction, Segment
from telepresence.link.figures import PathFigures, QueueFigures
from telepresence.link.peer.figures import PeerFigures
from telepresence.link.profile import LinkProfile


def link_figures(setup: Setup, collector: Collector, direction: str) -> DirectionReport:
    """One direction of the link, from what its two gateways have reported."""
    up = direction == "uplink"
    link = collector.topology.link(Direction(direction))
    near, far = collector.process(link.sender), collector.process(link.receiver)
    sent = [link.transmit for link in near.links()]
    received = [link.receive for link in far.links()]
    need = setup.need_up() if up else setup.need_down()
    profile = setup.uplink if up else setup.downlink
    octets = _sum_tables([life.octets for life in sent])
    frames = sum(life.frames for life in sent)
    return DirectionReport(
        capacity_bps=profile.capacity_bps,
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
        frames=frames,
        freed_bps=_freed_bps(profile, frames, octets),
        frames_lost=sum(life.frames_lost for life in received),
        frames_dropped=_sum_tables([life.frames_dropped for life in received]),
        octets=octets,
        octets_percent=ledger_percent(octets),
        queue=_merged_queues([life.queue for life in sent]),
        headers=_merged_headers([life.headers for life in sent]),
        refused=_sum_tables([life.refused for life in sent]),
        packets=_sum_tables([life.packets for life in received]),
        packets_dropped=_sum_tables([life.packets_dropped for life in received]),
        lateness_us=punctuality_us(near.lateness),
        sent_after_us=punctuality_us(near.sending),
        slips=near.total(LoopCounters).slips,
    )


def _freed_bps(profile: LinkProfile, frames: int, octets: Mapping[str, int]) -> int:
    """The rate (bit/s) that slots without a sample left to the levels below haptics."""
    freed_octets = frames * profile.insert_octets - octets.get("haptic", 0)
    return round(freed_octets * 8 * NS_PER_S / max(frames * profile.slot_ns, 1))


def _sum_tables(tables: list[dict[str, int]]) -> dict[str, int]:
    sums: dict[str, int] = {}
    for table in tables:
        for name, value in table.items():
            sums[name] = sums.get(name, 0) + value
    return sums


def _merged_queues(lives: list[dict[str, QueueFigures]]) -> dict[str, QueueFigures]:
    """The queue of each level: its state in the last life, and the counts of all lives."""
    merged: dict[str, QueueFigures] = {}
    for life in lives:
        for level, queue in life.items():
            before = merged.get(level)
            if before is not None:
                queue = replace(
                    queue,
                    accepted=before.accepted + queue.accepted,
                    drops=_sum_tables([before.drops, queue.drops]),
                    delayed=before.delayed + queue.delayed,
                    max_packets=max(before.max_packets, queue.max_packets),
                    max_octets=max(before.max_octets, queue.max_octets),
                    max_age_ns=max(before.max_age_ns, queue.max_age_ns),
                )
            merged[level] = queue
    return merged


def _merged_headers(lives: list[dict[str, dict[str, int]]]) -> dict[str, dict[str, int]]:
    flows = dict.fromkeys(flow for life in lives for flow in life)
    return {flow: _sum_tables([life.get(flow, {}) for life in lives]) for flow in flows}


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
    """What only this end knows: supervision and radio of its last life, and unknown senders."""
    segment = Segment(end)
    figures = collector.process(collector.topology.gateway(segment).name)
    last = next(reversed(list(figures.links())), None)
    peer = figures.gauges(PeerGauges)
    return GatewayReport(
        supervision=None if last is None else last.supervision,
        radio=None if last is None else _radio(last.radio),
        strangers=stranger_counts(collector, segment),
        unsent=figures.total(GatewayCounters).unsent,
        clock=None if last is None else last.clock,
        peer=_peer(peer),
        radio_back=None if peer is None or peer.back is None else _radio(peer.back),
    )


def _peer(gauges: PeerGauges | None) -> PeerReport | None:
    if gauges is None:
        return None
    peer = gauges.peer
    return PeerReport(
        protected=peer.protected,
        identity=peer.identity or None,
        address=peer.address or None,
        session_ns=peer.session_ns,
        sessions=peer.sessions,
        failed_attempts=peer.failed_attempts,
        address_changes=peer.address_changes,
        sent=peer.sent,
        unsent=peer.unsent,
        taken=peer.taken,
        handshake_datagrams=peer.handshake_datagrams,
        dropped=dict(peer.dropped),
        events=[PeerEventReport(at_ns=event.at_ns, what=event.what) for event in peer.events],
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


def stranger_counts(collector: Collector, segment: Segment) -> dict[str, int]:
    """By port of a gateway: the datagrams of unknown senders, if there were any.

    A port is named by what it receives: "radio", "haptic", or the name of a flow.
    """
    topology = collector.topology
    counters = collector.process(topology.gateway(segment).name).total(GatewayCounters)
    return {name: count for name, count in sorted(counters.strangers.items()) if count}


def _radio(path: PathFigures) -> RadioReport:
    channel = path.channel
    return RadioReport(
        delay_ns=path.delay_ns,
        delay_min_ns=path.delay_min_ns,
        delay_max_ns=path.delay_max_ns,
        frames_sent=path.frames_sent,
        frames_lost=path.frames_lost,
        frames_hit=path.frames_hit,
        bits_flipped=path.bits_flipped,
        frames_under_way=path.frames_under_way,
        no_signal_ns=None if channel is None else path.no_signal_ns,
        profile=None if channel is None else channel.profile,
        direction=None if channel is None else channel.direction,
        blackout_ns=None if channel is None else channel.blackout_ns,
        contact=None if channel is None else channel.contact,
    )


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
