"""The link in a report: its directions, its ends, the report of `kontur-av link`; all in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import chain
from typing import TypeVar

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from kontur_av.metrics import plus
from pipelines.link.link_metrics import SocketMetrics, WayInMetrics
from pipelines.report import model
from pipelines.report.collector import Collector
from pipelines.report.sections import cpu_report, process_report
from pipelines.report.warnings import find_loop_warnings, find_path_warnings
from pipelines.session.session_metrics import LoopMetrics, ProcessNow
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.verdict import process_failures
from telepresence.link.link_metrics import (
    PeerMetrics,
    ReceiverMetrics,
    SenderMetrics,
    SupervisionMetrics,
)
from telepresence.link.profile import LinkProfile


def build_link_report(
    collector: Collector,
    ends: Sequence[Segment],
    *,
    seconds: float,
    seed: int,
    processes: Sequence[ProcessNow],
    launcher_cpu_s: float = 0.0,
) -> model.LinkReport:
    """The whole report. With one end alone each direction lacks what the other end would count.

    seconds: how long the link ran. processes: as the launcher knows them.
    """
    return model.LinkReport(
        setup=collector.setup.name,
        seconds=round(seconds, 3),
        ends=[end.value for end in ends],
        radio=model.LinkRadio(profile=collector.setup.radio_profile.name, seed=seed),
        link={
            direction: link_metrics(collector, direction) for direction in ("uplink", "downlink")
        },
        gateways={end.value: gateway_metrics(collector, end.value) for end in ends},
        cpu=cpu_report(processes, launcher_cpu_s, seconds),
        processes={process.name: process_report(process, collector) for process in processes},
        # Silence is not a failure: the radio decides it.
        failures=process_failures(processes),
        warnings=[
            *chain.from_iterable(find_loop_warnings(collector, each.name) for each in processes),
            *find_path_warnings(collector, ends),
        ],
    )


def direction_lines(direction: str, link: model.DirectionReport) -> Iterator[str]:
    """What a direction sent and when, the uses of its octets, and what was received and dropped."""
    sender, receiver = link.sender, link.receiver
    if sender.frames:
        late, sent = link.lateness_us, link.sent_after_us
        yield (
            f"{direction}: {sender.frames} frames sent, {link.loop.slips} slips; slots late by "
            f"{late.p50:.0f} µs (p50), {late.p99:.0f} (p99), {late.p99_9:.0f} (p99.9), "
            f"{late.max:.0f} at most; sent after {sent.p50:.0f} (p50), {sent.p99:.0f} "
            "(p99)"
        )
        used = ", ".join(f"{kind} {share:.2f}" for kind, share in link.octets_percent.items())
        yield f"  of {sum(sender.octets.values())} octets, in %: {used}"
        drops = {
            f"{level}, {reason}": count
            for level, queue in sender.queue.items()
            for reason, count in queue.drops.items()
            if count
        } | {f"refused, {reason}": count for reason, count in sender.refused.items() if count}
        if drops:
            yield "  not sent: " + ", ".join(f"{n} ({why})" for why, n in drops.items())
    if receiver.packets:
        came = ", ".join(f"{name} {count}" for name, count in receiver.packets.items() if count)
        frames = f"{receiver.frames_lost} frames lost"
        if receiver.repaired is not None:
            frames += f", {receiver.repaired.zones} of them restored"
        yield f"{direction} received: {frames}; packets {came or 'none'}"
        dropped = {**receiver.frames_dropped, **receiver.packets_dropped}
        if dropped:
            yield "  dropped: " + ", ".join(f"{n} {why}" for why, n in dropped.items())


def state_words(supervision: SupervisionMetrics) -> str:
    """The present state; with its reason if somebody has to fix it."""
    state = supervision.state
    return f"{state} ({supervision.why})" if state in ("check", "refused") else state


def peer_lines(end: str, gateway: model.GatewayReport) -> list[str]:
    """The path to the other machine, if there is one."""
    peer = gateway.peer
    if peer is None:
        return []
    state = "no session" if peer.session_ns is None else f"{peer.address}"
    line = (
        f"{end}, path: {state}; {peer.sessions} sessions, {peer.failed_attempts} handshakes "
        f"failed, {peer.address_changes} changes of address; {peer.taken} frames taken"
    )
    if peer.dropped:
        line += ", dropped: " + ", ".join(f"{n} {why}" for why, n in peer.dropped.items())
    return [line if peer.protected else f"{line}; NOT PROTECTED"]


def end_line(end: str, gateway: model.GatewayReport) -> str:
    supervision = gateway.supervision
    contacts = 0 if supervision is None else len(supervision.contacts)
    contact_s = 0.0 if supervision is None else supervision.contact_ns / NS_PER_S
    state = "never ran" if supervision is None else state_words(supervision)
    line = f"{end}: {state}, {contact_s:.1f} s of signal in {contacts} contacts"
    if gateway.sockets.unknown_senders:
        counts = ", ".join(
            f"{name} {count}" for name, count in gateway.sockets.unknown_senders.items()
        )
        line += f"; from unknown senders: {counts}"
    if gateway.sockets.unsent:
        line += f"; {gateway.sockets.unsent} frames not sent"
    return line


def clock_lines(gateways: Mapping[str, model.GatewayReport]) -> Iterator[str]:
    """For each end whose peer is on another machine: where the peer's clock is, with the error."""
    for end, gateway in gateways.items():
        if (clock := gateway.clock) is None:
            continue
        peer = Segment(end).peer.value
        if clock.offset_ns is None or clock.error_ns is None:
            yield f"clock: {peer}'s is not known"
            continue
        error_ms = clock.error_ns / NS_PER_MS
        words = f"clock: {peer} is {clock.offset_ns / NS_PER_S:+.6f} s ± {error_ms:.2f} ms"
        if clock.drift_ppb is not None and clock.drift_error_ppb is not None:
            drift, error = clock.drift_ppb / 1000, clock.drift_error_ppb / 1000
            words += f", drift {drift:.1f} ± {error:.1f} ppm"
        yield words + (f"; stepped {clock.restarts} times" if clock.restarts else "")


RecordT = TypeVar("RecordT")


def link_metrics(collector: Collector, direction: str) -> model.DirectionReport:
    """One direction of the link, from what its two gateways have reported."""
    setup = collector.setup
    link = collector.topology.link(Direction(direction))
    near, far = collector.process(link.sender), collector.process(link.receiver)
    sent = _all_boots(SenderMetrics(), [boot_id.transmit for boot_id in near.links()])
    received = _all_boots(ReceiverMetrics(), [boot_id.receive for boot_id in far.links()])
    need, profile = setup.need(link.direction), setup.profile(link.direction)
    return model.DirectionReport(
        # Known even if the sender is on another machine.
        sender=replace(sent, capacity_bps=profile.capacity_bps),
        receiver=received,
        below_haptics_bps=profile.media_bps,
        needed_at_caps_bps=model.NeedReport(
            payload=need.payload_bps,
            headers=need.overhead_bps,
            reserve=need.reserve_bps,
            spare=need.spare_bps,
        ),
        arithmetic=[
            model.LineReport(what=line.what, stream=line.stream, bps=line.bps)
            for line in setup.channel_table(link.direction)
        ],
        freed_bps=_freed_bps(profile, sent),
        octets_percent=ledger_percent(sent.octets),
        lateness_us=punctuality_us(near.lateness),
        sent_after_us=punctuality_us(near.sending),
        loop=near.total(LoopMetrics),
    )


def _all_boots(nothing: RecordT, lives: Sequence[RecordT]) -> RecordT:
    return reduce(plus, lives[1:], lives[0]) if lives else nothing


def _freed_bps(profile: LinkProfile, sent: SenderMetrics) -> int:
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


def gateway_metrics(collector: Collector, end: str) -> model.GatewayReport:
    """What only this end knows: the link of its last start, and its sockets."""
    metrics = collector.gateway(Segment(end))
    last = next(reversed(list(metrics.links())), None)
    return model.GatewayReport(
        supervision=None if last is None else last.supervision,
        radio=None if last is None else last.radio,
        sockets=metrics.total(SocketMetrics),
        clock=None if last is None else last.clock,
        peer=metrics.find(PeerMetrics),
        way_in=metrics.find(WayInMetrics),
    )


def peer_words(metrics: PeerMetrics) -> str:
    """The state of the path to the other machine, in a few words."""
    found = metrics.address or "nobody has called"
    words = f"{'no session' if metrics.session_ns is None else 'path'} {found}"
    dropped = sum(metrics.dropped.values())
    if dropped:
        reason = max(metrics.dropped, key=lambda name: metrics.dropped[name])
        words += f", {dropped} datagrams dropped (most: {reason})"
    if metrics.path_state != "all":
        cap = f"video at most {metrics.video_cap_bps / 1000:.0f} kbit/s"
        words += f", {metrics.path_state}, {cap}: {metrics.path_why}"
    return words if metrics.protected else f"NOT PROTECTED, {words}"


def punctuality_us(histogram: Histogram) -> model.Punctuality:
    """Percentiles of values in ns, in µs."""
    summary = histogram.summary_ms()
    us = {name: round(summary[name] * 1000, 1) for name in ("p50", "p95", "p99", "max")}
    return model.Punctuality(**us, p99_9=round(histogram.percentile(99.9) / NS_PER_US, 1))
