"""Runs two ends of a link over loopback, and sends haptic samples through them both ways.

As a program, `python -m pipelines.bench.link.protected SECONDS link ...` is `kontur-av link ...`
with new keys every SECONDS; 0 for the channel's own interval.
"""

import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.bench.link.live import lateness_us
from pipelines.bench.link.paired import PLAIN, REKEYED, EndFigures, PairedRun, delays_us
from pipelines.link.key_files import make_key, trust
from pipelines.report.model import LinkReport, from_json
from pipelines.session.children import end_all, ended_alike
from pipelines.session.datagrams import LOOPBACK
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.topology import Segment, Topology
from pipelines.table import topology_of

#: How often the keys are new in the runs of `REKEYED`: one handshake a second is allowed.
REKEY_S = 2.0
#: After so long both ends have found each other.
_SETTLE_S = 3.0
_PATIENCE_S = 60.0
_SAMPLE_OCTETS = 12
_SLOT_NS = NS_PER_MS
#: The slots begin at whole milliseconds, as in a session.
_PHASE_NS = _SLOT_NS // 2
#: linux/socket.h: arrival times of the kernel, by the wall clock.
_SO_TIMESTAMPNS = 35
_TIME_OCTETS = 16


def paired_run(way: str, *, setup: str, seconds: float, base_port: int) -> PairedRun:
    """Run both ends for `seconds`; RuntimeError if one fails."""
    with ended_alike(), TemporaryDirectory() as name:
        directory = Path(name)
        keys = {end: directory / f"{end}.pem" for end in ("ground", "space")}
        made = {end: make_key(path) for end, path in keys.items()}
        trust(keys["ground"], made["space"].identity)
        trust(keys["space"], made["ground"].identity)
        topologies = {
            end: topology_of(load_setup(setup, changes={"base_port": base_port + offset}))
            for end, offset in (("ground", 0), ("space", 100))
        }
        whole_s = seconds + _SETTLE_S + 1.0
        processes = {}
        for end, topology in topologies.items():
            path = f"{LOOPBACK}:{base_port}"
            words = ["link", "--setup", setup, "--end", end, "-q", "--seconds", f"{whole_s:g}"]
            words += ["--listen" if end == "ground" else "--peer", path]
            words += ["--base-port", str(topology.setup.base_port)]
            words += ["--report", str(directory / f"{end}.json")]
            words += ["--insecure"] if way == PLAIN else ["--key", str(keys[end])]
            every_s = REKEY_S if way == REKEYED else 0
            processes[end] = subprocess.Popen(
                [sys.executable, "-m", "pipelines.bench.link.protected", f"{every_s:g}", *words],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        try:
            delays = _exchange(topologies, seconds)
            for end, process in processes.items():
                if process.wait(_PATIENCE_S):
                    raise RuntimeError(f"the {end} end of the link failed")
        finally:
            end_all(list(processes.values()))
        reports = {
            end: from_json((directory / f"{end}.json").read_bytes(), LinkReport) for end in keys
        }
    return PairedRun(
        way=way,
        delay_us={direction: delays_us(found) for direction, found in delays.items()},
        samples=sum(map(len, delays.values())),
        frames_lost=sum(
            reports[end].link[direction].receiver.frames_lost
            for end, direction in (("ground", "downlink"), ("space", "uplink"))
        ),
        ends={end: _end(report, end, whole_s) for end, report in reports.items()},
    )


def _end(report: LinkReport, end: str, seconds: float) -> EndFigures:
    link = report.link["uplink" if end == "ground" else "downlink"]
    peer = report.gateways[end].peer
    return EndFigures(
        cpu_percent=100 * report.processes[f"{end}_gateway"].cpu_s / seconds,
        lateness_us=lateness_us(link),
        slips=link.loop.slips,
        sessions=0 if peer is None else peer.sessions,
    )


def _exchange(topologies: Mapping[str, Topology], seconds: float) -> dict[str, list[int]]:
    """Send a sample each way in every slot; return the delays (ns), by direction.

    A sample leaves in the middle between two slots. Its arrival is the kernel's stamp, so this
    process may be late in reading it.
    """
    ways = {}
    for segment in Segment:
        near, far = topologies[segment.value], topologies[segment.peer.value]
        row = next(row for row in near.haptics if row.direction is segment.transmits)
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        out.connect((LOOPBACK, row.entry_port))
        exit_port = next(one for one in far.haptics if one.key == row.key).exit_port
        back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        back.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        back.bind((LOOPBACK, exit_port))
        back.setblocking(False)
        ways[segment.transmits.value] = out, back
    sent: dict[str, dict[int, int]] = {name: {} for name in ways}
    delays: dict[str, list[int]] = {name: [] for name in ways}
    begin_ns = time.monotonic_ns()
    settled_ns = begin_ns + round(_SETTLE_S * NS_PER_S)
    due_ns = (begin_ns // _SLOT_NS + 1) * _SLOT_NS + _PHASE_NS
    number = 0
    readers = [back for _, back in ways.values()]
    try:
        while (now_ns := time.monotonic_ns()) < settled_ns + round(seconds * NS_PER_S):
            if now_ns < due_ns:
                select.select(readers, (), (), (due_ns - now_ns) / NS_PER_S)
            for name, (_, back) in ways.items():
                _take(back, sent[name], delays[name])
            if time.monotonic_ns() < due_ns:
                continue
            number += 1
            for name, (out, _) in ways.items():
                # A late sample would meet another slot than its own.
                if time.monotonic_ns() - due_ns < _PHASE_NS // 2:
                    if due_ns >= settled_ns:
                        sent[name][number] = time.time_ns()
                    _send(out, number)
            due_ns += _SLOT_NS * (1 + max(0, (time.monotonic_ns() - due_ns) // _SLOT_NS))
    finally:
        for out, back in ways.values():
            out.close()
            back.close()
    return delays


def _send(out: socket.socket, number: int) -> None:
    try:
        out.send(number.to_bytes(_SAMPLE_OCTETS, "big"))
    except OSError:
        return  # the end does not listen yet


def _take(back: socket.socket, sent: dict[int, int], delays: list[int]) -> None:
    while True:
        try:
            sample, ancillary, _, _ = back.recvmsg(_SAMPLE_OCTETS, socket.CMSG_SPACE(_TIME_OCTETS))
        except OSError:
            return
        sent_ns = sent.pop(int.from_bytes(sample, "big"), None)
        arrived_ns = _arrived_ns(ancillary)
        if sent_ns is not None and arrived_ns is not None:
            delays.append(arrived_ns - sent_ns)


def _arrived_ns(ancillary: Sequence[tuple[int, int, bytes]]) -> int | None:
    for _, _, data in ancillary:
        seconds, rest_ns = (int.from_bytes(data[at : at + 8], sys.byteorder) for at in (0, 8))
        return seconds * NS_PER_S + rest_ns
    return None


def _run_end() -> int:
    from pipelines.cli import make_parser

    every_s, *words = sys.argv[1:]
    args = make_parser("link").parse_args(words)
    args.rekey_ns = round(float(every_s) * NS_PER_S) or None
    result: int = args.run(args)
    return result


if __name__ == "__main__":
    sys.exit(_run_end())
