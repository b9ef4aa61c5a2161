"""The link in a report: each direction with its ledger, and what its two ends have noticed."""

from collections.abc import Mapping
from typing import Any

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from pipelines.report.collector import Collector
from pipelines.setup.table import Setup
from pipelines.topology import Direction, Segment
from telepresence.link.profile import LinkProfile


def link_figures(setup: Setup, collector: Collector, direction: str) -> dict[str, Any]:
    """One direction of the link, as far as its two gateways have told of it."""
    up = direction == "uplink"
    link = collector.topology.link(Direction(direction))
    near, far = collector.process(link.sender), collector.process(link.receiver)
    lives = [link["transmit"] for link in near.links()]
    need = setup.need_up() if up else setup.need_down()
    profile = setup.uplink if up else setup.downlink
    octets: dict[str, int] = {}
    for life in lives:
        for kind, count in life["octets"].items():
            octets[kind] = octets.get(kind, 0) + count
    received = [link["receive"] for link in far.links()]
    return {
        "capacity_bps": profile.capacity_bps,
        "below_haptics_bps": profile.media_bps,
        "needed_at_caps_bps": {
            "payload": need.payload_bps,
            "headers": need.overhead_bps,
            "reserve": need.reserve_bps,
            "spare": need.spare_bps,
        },
        "arithmetic": [
            {"what": line.what, "stream": line.stream, "bps": line.bps}
            for line in setup.channel_table(direction)
        ],
        "frames": sum(life["frames"] for life in lives),
        "freed_bps": _freed_bps(profile, sum(life["frames"] for life in lives), octets),
        "frames_lost": sum(life["frames_lost"] for life in received),
        "frames_dropped": _sum_tables([life["frames_dropped"] for life in received]),
        "octets": octets,
        "octets_percent": ledger_percent(octets),
        "queue": _merged_queues([life["queue"] for life in lives]),
        "headers": _merged_headers([life["headers"] for life in lives]),
        "refused": _sum_tables([life["refused"] for life in lives]),
        "packets": _sum_tables([life["packets"] for life in received]),
        "packets_dropped": _sum_tables([life["packets_dropped"] for life in received]),
        "lateness_us": summary_us(near.lateness),
        "sent_after_us": summary_us(near.sending),
        "slips": near.total("slips"),
    }


def _freed_bps(profile: LinkProfile, frames: int, octets: Mapping[str, int]) -> int:
    """What the slots without a sample have left to the levels below haptics."""
    freed_octets = frames * profile.insert_octets - octets.get("haptic", 0)
    return round(freed_octets * 8 * NS_PER_S / max(frames * profile.slot_ns, 1))


def _sum_tables(tables: list[dict[str, int]]) -> dict[str, int]:
    sums: dict[str, int] = {}
    for table in tables:
        for name, value in table.items():
            sums[name] = sums.get(name, 0) + value
    return sums


def _merged_queues(lives: list[dict[str, dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Each level's queue: as the last life left it, with what all lives counted."""
    merged: dict[str, dict[str, Any]] = {}
    for life in lives:
        for level, queue in life.items():
            before = merged.get(level)
            merged[level] = dict(queue)
            if before is None:
                continue
            merged[level].update(
                accepted=before["accepted"] + queue["accepted"],
                drops=_sum_tables([before["drops"], queue["drops"]]),
                **{name: max(before[name], queue[name]) for name in ("max_octets", "max_age_ns")},
            )
    return merged


def _merged_headers(lives: list[dict[str, dict[str, int]]]) -> dict[str, dict[str, int]]:
    flows = dict.fromkeys(flow for life in lives for flow in life)
    return {flow: _sum_tables([life.get(flow, {}) for life in lives]) for flow in flows}


def ledger_percent(octets: Mapping[str, int]) -> dict[str, float]:
    """The shares of all octets in percent, to two digits; they sum to 100.00 exactly.

    What rounding down leaves goes, a hundredth each, to those that lost most by it.
    """
    total = sum(octets.values())
    if not total:
        return {}
    shares = {kind: divmod(10_000 * count, total) for kind, count in octets.items()}
    left = 10_000 - sum(whole for whole, _ in shares.values())
    losers = sorted(shares, key=lambda kind: shares[kind][1], reverse=True)[:left]
    return {kind: (whole + (kind in losers)) / 100 for kind, (whole, _) in shares.items()}


def gateway_figures(collector: Collector, end: str) -> dict[str, Any]:
    """What only this end knows: its supervision and its radio of the last life, and strangers."""
    segment = Segment(end)
    figures = collector.process(collector.topology.gateway(segment).name)
    last = list(figures.links())[-1:]
    names = ("supervision", "radio")
    told: dict[str, Any] = {name: link[name] for link in last for name in names if name in link}
    strangers = stranger_counts(collector, segment)
    return {**told, "strangers": strangers, "unsent": figures.total("unsent")}


def stranger_counts(collector: Collector, segment: Segment) -> dict[str, int]:
    """By port of a gateway: the datagrams that came to it from anybody else, where there were any.

    A port is named by what it takes: "radio", "haptic", or the name of a flow.
    """
    topology = collector.topology
    figures = collector.process(topology.gateway(segment).name)
    flows = (flow.name for flow in topology.flows(segment.transmits))
    counts = {name: figures.total(f"strangers_{name}") for name in ("radio", "haptic", *flows)}
    return {name: count for name, count in sorted(counts.items()) if count}


def summary_us(histogram: Histogram) -> dict[str, float]:
    """A histogram's summary in microseconds."""
    return {
        **{name: round(value * 1000, 1) for name, value in histogram.summary_ms().items()},
        "p99.9": round(histogram.percentile(99.9) / NS_PER_US, 1),
    }
