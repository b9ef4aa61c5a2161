"""`kontur-av bench link`: punctuality and CPU cost of the link on this machine."""

import argparse
import re
import shutil
import struct
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import BLOCK_SAMPLES, VIDEO_CLOCK_HZ
from kontur_av.meters import Histogram
from pipelines.bench.session import live_report
from pipelines.report.model import DirectionReport, LinkReport, SessionReport, from_json
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, Percentiles, as_json, headline_tables
from pipelines.session.option_rows import add_options
from pipelines.session.setup.setup_file import load_setup
from telepresence.link.flows import Flow, Level, packet_flow, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

#: The end of `cyclictest`'s histogram, in µs; it counts later wake-ups apart.
_LONGEST_US = 20_000
#: How much longer than its run `cyclictest` may take to end.
_TIMEOUT_S = 60


@dataclass(frozen=True)
class LoopPunctuality:
    """Of one periodic task of 1 ms, in µs after its deadlines: p50, p99, p99.9 and max.

    slips: deadlines that passed unused, of `cycles`; None where nothing counts them.
    """

    name: str
    lateness_us: dict[str, float]
    slips: int | None = None
    cycles: int | None = None


def live_punctuality(
    seconds: float, setup: str, *, media: bool, base_port: int
) -> list[LoopPunctuality]:
    """Run both gateways for `seconds`, with or without the whole session beside them.

    `cyclictest`, if it is installed and permitted, runs at the same time and comes first: with the
    same period, and with the gateways' real-time priority.
    """
    words = ["stream" if media else "link", "--setup", setup, "--base-port", str(base_port)]
    peer = _start_cyclictest(seconds)
    try:
        text = live_report(words, seconds=seconds)
    finally:
        metrics = [] if peer is None else _finish_cyclictest(peer)
    links = from_json(text, SessionReport).link if media else from_json(text, LinkReport).link
    ends = {"ground": links["uplink"], "space": links["downlink"]}
    gateways = [
        LoopPunctuality(f"{end} gateway", lateness_us(link), link.loop.slips, link.sender.frames)
        for end, link in ends.items()
    ]
    return [*metrics, *gateways]


def lateness_us(link: DirectionReport) -> dict[str, float]:
    """How late the slots of a direction began."""
    late = link.lateness_us
    return {"p50": late.p50, "p99": late.p99, "p99.9": late.p99_9, "max": late.max}


def _start_cyclictest(seconds: float) -> "subprocess.Popen[str] | None":
    program = shutil.which("cyclictest")
    if program is None:
        return None
    command = [program, "--threads=1", "--priority=10", "--interval=1000", "--quiet"]
    command += ["--mlockall", f"--duration={max(1, round(seconds))}", f"--histogram={_LONGEST_US}"]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
        text=True,
    )


def _finish_cyclictest(process: "subprocess.Popen[str]") -> list[LoopPunctuality]:
    output, _ = process.communicate(timeout=_TIMEOUT_S)
    return [] if process.returncode else [parse_cyclictest(output)]


def parse_cyclictest(output: str) -> LoopPunctuality:
    """The figures of a run with a histogram of one thread; ValueError if there are none."""
    bins = [(int(us), int(count)) for us, count in re.findall(r"^(\d+) (\d+)$", output, re.M)]
    total = sum(count for _, count in bins)
    largest = re.search(r"^# Max Latencies: (\d+)", output, re.M)
    overflows = re.search(r"^# Histogram Overflows: (\d+)", output, re.M)
    if not total or largest is None:
        raise ValueError("cyclictest printed no histogram")
    beyond = int(overflows[1]) if overflows else 0
    metrics: dict[str, float] = {}
    for name, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999)):
        wanted = share * (total + beyond)
        seen = 0
        for us, count in bins:
            seen += count
            if seen >= wanted:
                metrics[name] = float(us)
                break
        else:
            metrics[name] = float(largest[1])
    metrics["max"] = float(largest[1])
    return LoopPunctuality("cyclictest", metrics, None, total + beyond)


COMMANDS, VOICE, VIDEO, FILE = "commands", "voice", "video", "file"

#: One flow a level. Commands are carried as they are, so that they may have any length.
FLOWS: tuple[Flow, ...] = (
    packet_flow(COMMANDS, Level.TMTC),
    voice_flow(VOICE),
    video_flow(VIDEO),
    packet_flow(FILE, Level.MAINTENANCE),
)

_RTP = struct.Struct(">BBHII")


@dataclass
class Talker:
    """Makes the RTP packets of one voice or one video."""

    flow: str
    payload_octets: int
    ssrc: int = 0x6B6F6E74
    sequence: int = 0xFFF0

    def packet(self, now_ns: int, *, last: bool = True) -> bytes:
        """The next packet; the timestamp of voice counts samples, that of video is `now_ns`.

        last: whether it ends its picture; sets the marker (RFC 6184).
        """
        if self.flow == VOICE:
            timestamp = self.sequence * BLOCK_SAMPLES
            second = 97
        else:
            timestamp = now_ns * VIDEO_CLOCK_HZ // NS_PER_S
            second = last << 7 | 96
        header = _RTP.pack(0x80, second, self.sequence & 0xFFFF, timestamp & 0xFFFF_FFFF, self.ssrc)
        self.sequence += 1
        return header + bytes(self.payload_octets)


#: The first slots fill caches.
_WARM_UP_SLOTS = 500


@dataclass(frozen=True, slots=True)
class Cost:
    """Time (us) of a slot. what: `send`, which is `poll_transmit`, or `receive`: `handle_frame`."""

    direction: str
    traffic: str
    what: str
    us: Percentiles


def slot_costs(profile: LinkProfile, *, slots: int, busy: bool) -> list[Cost]:
    """Measure `slots` slots on the real clock, each with a sample.

    busy: also a voice packet every 20 slots, and endless video and files.
    """
    clock_ns = MonotonicClock().now_ns
    sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
    voice, video = Talker(VOICE, 19), Talker(VIDEO, 354)
    send, receive = Histogram(), Histogram()
    for slot in range(_WARM_UP_SLOTS + slots):
        now_ns = slot * NS_PER_MS
        if busy:
            if slot % 20 == 0:
                sender.handle_packet(VOICE, voice.packet(now_ns), now_ns)
            while sender.waiting_octets(Level.VIDEO) < 1024:
                sender.handle_packet(VIDEO, video.packet(now_ns), now_ns)
            while sender.waiting_octets(Level.MAINTENANCE) < 1024:
                sender.handle_packet(FILE, bytes(200), now_ns)
        sender.handle_haptic(bytes(12), now_ns)
        begun_ns = clock_ns()
        frame = sender.poll_transmit(now_ns)
        sent_ns = clock_ns()
        receiver.handle_frame(frame, now_ns)
        while receiver.next_event() is not None:
            pass
        read_ns = clock_ns()
        if slot >= _WARM_UP_SLOTS:
            send.add(sent_ns - begun_ns)
            receive.add(read_ns - sent_ns)
    traffic = "saturated" if busy else "samples only"
    return [
        Cost(profile.name, traffic, what, _times(times))
        for what, times in (("send", send), ("receive", receive))
    ]


def _times(histogram: Histogram) -> Percentiles:
    p50, p95, p99 = (round(histogram.percentile(p) / NS_PER_US, 2) for p in (50, 95, 99))
    return Percentiles(p50, p95, p99, round(histogram.max / NS_PER_US, 2))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--seconds S <float=20.0>  of each run (default 20)",
        "--setup NAME <=spacejustin>  of the live runs",
        "--no-live  the cost of a slot only",
        "--base-port P <int=27000>  of live runs",
        "--report",
    )


def run(args: argparse.Namespace) -> int:
    if not 1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 3600")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    costs = [
        cost
        for profile in (UPLINK, DOWNLINK)
        for busy in (False, True)
        for cost in slot_costs(profile, slots=round(1000 * args.seconds), busy=busy)
    ]
    metrics: dict[str, Json] = {"cost": as_json(costs)}
    live: dict[str, Sequence[LoopPunctuality]] = {}
    for media in () if args.no_live else (False, True):
        name = "with" if media else "without"
        live[name] = live_punctuality(
            args.seconds, args.setup, media=media, base_port=args.base_port
        )
        metrics[f"live_{name}_media"] = as_json(live[name])
    found = _headlines(costs, live)
    console.print(*headline_tables(found))
    if live and not any(task.name == "cyclictest" for tasks in live.values() for task in tasks):
        console.print("cyclictest is not installed or not permitted (Debian package rt-tests)")
    write_result(args.report, metrics, found)
    return 0


def _headlines(
    costs: Sequence[Cost], live: Mapping[str, Sequence[LoopPunctuality]]
) -> list[Headline]:
    found = []
    for cost in costs:
        what, group = f"{cost.direction}, {cost.traffic}", "cost of a slot, p50"
        found.append(Headline(group=group, what=what, who=cost.what, unit="µs", value=cost.us.p50))
    for name, tasks in live.items():
        for task in tasks:
            who, late_us = f"{name} media", task.lateness_us["p99"]
            what = f"{task.name}: after the deadline, p99"
            found.append(Headline(group="live", what=what, who=who, unit="µs", value=late_us))
            if task.slips is not None and task.cycles:
                what, share = f"{task.name}: slots left out", 100 * task.slips / task.cycles
                found.append(Headline(group="live", what=what, who=who, unit="%", value=share))
    return found
