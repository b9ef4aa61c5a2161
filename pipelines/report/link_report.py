"""What `kontur-av link` shows of its link: the report, a line a second, and the summary."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import TypeVar

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.meters import Histogram
from kontur_av.metrics import plus
from pipelines.link.link_metrics import SocketMetrics, WayInMetrics
from pipelines.report import model
from pipelines.report.collector import Collector
from pipelines.report.result import fitted_line
from pipelines.report.sections import clock_words, cpu_report, process_report
from pipelines.report.warnings import find_loop_warnings, find_path_warnings
from pipelines.session.session_metrics import LoopMetrics
from pipelines.session.setup.table import Setup
from pipelines.session.topology import Direction, Segment
from pipelines.session.verdict import ProcessNow, process_failures
from telepresence.link.link_metrics import (
    PeerMetrics,
    ReceiverMetrics,
    SenderMetrics,
    SupervisionMetrics,
)
from telepresence.link.profile import LinkProfile

#: The keys of the ledger whose rates stand in a line.
_LEVELS = ("haptic", "tmtc", "voice", "video", "maintenance")


def build_link_report(
    collector: Collector,
    ends: Sequence[Segment],
    *,
    seconds: float,
    seed: int,
    cpu_s: Mapping[str, float],
    restarts: Mapping[str, int],
    launcher_cpu_s: float,
    processes: Sequence[ProcessNow] = (),
) -> model.LinkReport:
    """The whole report. With one end alone each direction lacks what the other end would count.

    seconds: how long the link ran. cpu_s, restarts: of each process, over all its starts.
    processes: as the launcher knows them.
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
        cpu=cpu_report(cpu_s, launcher_cpu_s, seconds),
        processes={
            name: process_report(collector.process(name), cpu_s[name], restarts[name])
            for name in cpu_s
        },
        # Silence is not a failure: the radio decides it.
        failures=process_failures(processes),
        warnings=[
            *(warning for name in cpu_s for warning in find_loop_warnings(collector, name)),
            *find_path_warnings(collector, ends),
        ],
    )


class LinkView:
    """The present figures: for each end its state, what it sends by level, and what it lost."""

    def __init__(self, setup: Setup, ends: Sequence[Segment]) -> None:
        self._setup = setup
        self._ends = ends
        #: By end: the figures of its last line.
        self._seen = dict.fromkeys(ends, SenderMetrics())

    def lines(self, collector: Collector, seconds: float, width: int | None = None) -> list[str]:
        """A line for each end; rates are those since the lines before.

        width: the line's length in characters; parts without room are left out.
        """
        heads = [f"{seconds:6.1f} s  ", *[" " * 10] * (len(self._ends) - 1)]
        return [
            head + self._end(collector, end, None if width is None else width - len(head))
            for head, end in zip(heads, self._ends, strict=True)
        ]

    def _end(self, collector: Collector, end: Segment, width: int | None) -> str:
        metrics = collector.gateway(end)
        link = metrics.link
        if link is None:
            return f"{end.value}: starting"
        profile = self._setup.profile(end.transmits)
        sent, received = link.transmit, link.receive
        rates = _rates_kbps(sent, self._seen[end], profile)
        self._seen[end] = sent
        state = _state(link.supervision)
        levels = " ".join(f"{name} {rates[name]:.1f}" for name in _LEVELS)
        unknown_senders = sum(metrics.total(SocketMetrics).unknown_senders.values())
        parts = [
            f"{end.value} {state}",
            f"heard {received.frames_received} frames, {received.frames_lost} lost",
            f"{metrics.total(LoopMetrics).slips} slips",
            f"sends kbit/s {levels}",
        ]
        if unknown_senders:
            parts.insert(3, f"{unknown_senders} unknown senders")
        peer = metrics.find(PeerMetrics)
        if peer is not None:
            parts.insert(1, peer_words(peer))
        if link.clock is not None:
            parts.append(clock_words(end.peer.value, link.clock))
        return fitted_line(parts, width, gap=", ")


def _rates_kbps(sent: SenderMetrics, seen: SenderMetrics, profile: LinkProfile) -> dict[str, float]:
    # Time is counted in slots of the link, so the rate is exact even if the figures come late. A
    # restarted gateway counts from 0.
    if sent.frames < seen.frames:
        seen = SenderMetrics()
    seconds = max(1, sent.frames - seen.frames) * profile.slot_ns / NS_PER_S
    return {
        name: 8 * (sent.octets.get(name, 0) - seen.octets.get(name, 0)) / (1000 * seconds)
        for name in _LEVELS
    }


def summary_lines(report: model.LinkReport) -> list[str]:
    """The end of a run for people: each direction, its ledger, each end, the cost."""
    lines = [f"{report.setup}, {report.seconds:.1f} s, radio {report.radio.profile}"]
    for direction, link in report.link.items():
        lines += _direction(direction, link)
    for end, gateway in report.gateways.items():
        lines.append(end_line(end, gateway))
        lines += peer_lines(end, gateway)
        if gateway.clock is not None:
            lines.append(clock_words(Segment(end).peer.value, gateway.clock))
    cpu = report.cpu
    lines.append(f"CPU: {cpu.total_s:.1f} s, {cpu.cores_used:.2f} of a core")
    lines += [f"failed: {failure}" for failure in report.failures]
    for warning in report.warnings:
        lines.append(f"warning: {warning.where}: {warning.measured}; {warning.fix}")
    return lines


def _direction(direction: str, link: model.DirectionReport) -> list[str]:
    lines = []
    sender, receiver = link.sender, link.receiver
    if sender.frames:
        late, sent = link.lateness_us, link.sent_after_us
        lines.append(
            f"{direction}: {sender.frames} frames sent, {link.loop.slips} slips; slots late by "
            f"{late.p50:.0f} µs (p50), {late.p99:.0f} (p99), {late.p99_9:.0f} (p99.9), "
            f"{late.max:.0f} at most; sent after {sent.p50:.0f} (p50), {sent.p99:.0f} "
            "(p99)"
        )
        lines.append(f"  {ledger_line(link)}")
        drops = {
            f"{level}, {reason}": count
            for level, queue in sender.queue.items()
            for reason, count in queue.drops.items()
            if count
        } | {f"refused, {reason}": count for reason, count in sender.refused.items() if count}
        if drops:
            lines.append("  not sent: " + ", ".join(f"{n} ({why})" for why, n in drops.items()))
    if receiver.packets:
        came = ", ".join(f"{name} {count}" for name, count in receiver.packets.items() if count)
        frames = f"{receiver.frames_lost} frames lost"
        if receiver.repaired is not None:
            frames += f", {receiver.repaired.zones} of them restored"
        lines.append(f"{direction} received: {frames}; packets {came or 'none'}")
        dropped = {**receiver.frames_dropped, **receiver.packets_dropped}
        if dropped:
            lines.append("  dropped: " + ", ".join(f"{n} {why}" for why, n in dropped.items()))
    return lines


def _state(supervision: SupervisionMetrics) -> str:
    """The present state; with its reason if somebody has to fix it."""
    state = supervision.state
    return f"{state} ({supervision.why})" if state in ("check", "refused") else state


def ledger_line(link: model.DirectionReport) -> str:
    """The uses of a direction's octets; 100 % in all."""
    shares = link.octets_percent.items()
    used = ", ".join(f"{kind} {share:.2f}" for kind, share in shares)
    return f"of {sum(link.sender.octets.values())} octets, in %: {used}"


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
    state = "never ran" if supervision is None else _state(supervision)
    line = f"{end}: {state}, {contact_s:.1f} s of signal in {contacts} contacts"
    if gateway.sockets.unknown_senders:
        counts = ", ".join(
            f"{name} {count}" for name, count in gateway.sockets.unknown_senders.items()
        )
        line += f"; from unknown senders: {counts}"
    if gateway.sockets.unsent:
        line += f"; {gateway.sockets.unsent} frames not sent"
    return line


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
    return words if metrics.protected else f"NOT PROTECTED, {words}"


def punctuality_us(histogram: Histogram) -> model.Punctuality:
    """Percentiles of values in ns, in µs."""
    summary = histogram.summary_ms()
    us = {name: round(summary[name] * 1000, 1) for name in ("p50", "p95", "p99", "max")}
    return model.Punctuality(**us, p99_9=round(histogram.percentile(99.9) / NS_PER_US, 1))
