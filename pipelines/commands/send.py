"""`kontur-av send`: one stream from a source to plain RTP over UDP, under a hard cap."""

import argparse
import json
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h264 import REFRESH_S, SLOW_REFRESH_S
from kontur_av.codecs.h264_settings import SEARCHES
from kontur_av.meters import Histogram
from kontur_av.rtp.sdp import (
    StreamDescription,
    write_sdp,
)
from pipelines.commands.common import (
    check_options,
    open_socket,
    parse_address,
    stopped_by_signals,
    write_text,
)
from pipelines.commands.send_media import AudioOut, VideoOut, open_media

_LONGEST_WAIT_NS = 100 * NS_PER_MS
_FEEDBACK_OCTETS = 1500


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av send`."""
    what = parser.add_mutually_exclusive_group(required=True)
    spec = "FILE, pipe:PATH, v4l2:DEVICE or scene:NAME"
    what.add_argument("--video", metavar="SPEC", help=spec)
    what.add_argument("--audio", metavar="SPEC", help=spec.replace("v4l2", "alsa"))
    parser.add_argument("--to", metavar="HOST:PORT", required=True, help="RTCP goes to PORT+1")
    parser.add_argument(
        "--cap-kbps",
        metavar="K",
        type=float,
        required=True,
        help="hard cap on RTP payload over any second, in kbit/s",
    )
    parser.add_argument(
        "--channel-kbps",
        metavar="C",
        type=float,
        help="the rate at which packets of a picture leave (default: the cap)",
    )
    parser.add_argument("--size", metavar="WxH", default="640x480", help="default: 640x480")
    parser.add_argument(
        "--coded-size",
        metavar="WxH",
        default="auto",
        help="in which pictures are coded; receivers scale them up (default: auto, as large as "
        "there are bits for)",
    )
    parser.add_argument(
        "--refresh-s",
        metavar="S",
        type=float,
        help=f"renew the whole picture every S seconds (default: {SLOW_REFRESH_S:g} while a "
        f"receiver gives feedback, so that it can ask for a whole picture, else {REFRESH_S:g})",
    )
    parser.add_argument(
        "--search",
        choices=SEARCHES,
        default="thorough",
        help="for the best way to code pictures that are not coded small: quick takes half the "
        "time and loses 1 dB (default: thorough)",
    )
    parser.add_argument("--fps", metavar="N", type=int, default=30, help="default: 30")
    parser.add_argument("--seconds", metavar="S", type=float, help="default: until Ctrl-C")
    parser.add_argument("--sdp", metavar="FILE", help="write what receivers need to know")
    parser.add_argument("--report", metavar="FILE", help="write a JSON report")


def run(args: argparse.Namespace) -> int:
    """Send until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError, with nothing sent, for what cannot work.
    """
    check_options(args)
    address = parse_address(args.to)
    clock = MonotonicClock()
    with open_media(args, clock) as media:
        stream = StreamDescription(
            kind=media.kind,
            host=str(address[0]),
            port=address[1],
            payload_type=media.rtp.payload_type,
            bandwidth_bps=round(args.cap_kbps * 1000),
            parameter_sets=media.parameter_sets,
        )
        if args.sdp:
            write_text(args.sdp, write_sdp(stream), "--sdp")
        if args.report:
            write_text(args.report, "", "--report")
        with open_socket(address) as channel:
            report = _Shell(media, channel, address, clock).run(args.seconds)
    if args.report:
        write_text(args.report, json.dumps(report, indent=2) + "\n", "--report")
    for failure in report["failed"]:
        print(f"failed: {failure}", file=sys.stderr)
    return 1 if report["failed"] else 0


@dataclass(slots=True)
class _Unit:
    """What still has to leave before a capture is sent: up to this packet."""

    capture_ns: int
    last_packet: int


class _Shell:
    """Drives source, pacer and reports in real time."""

    def __init__(
        self,
        media: VideoOut | AudioOut,
        channel: socket.socket,
        address: tuple[str, int],
        clock: MonotonicClock,
    ) -> None:
        self._media = media
        self._socket = channel
        self._address = address
        self._clock = clock
        self._queued: list[_Unit] = []
        self._units_sent = 0
        self._sent_ns = Histogram()
        self._send_errors = 0

    def run(self, seconds: float | None) -> dict[str, Any]:
        """Send until the end; the report."""
        start_ns = self._clock.now_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * NS_PER_S)
        next_line_ns = start_ns + NS_PER_S
        with stopped_by_signals() as stopped:
            while not stopped():
                now_ns = self._clock.now_ns()
                if end_ns is not None and now_ns >= end_ns:
                    break
                if now_ns >= next_line_ns:
                    next_line_ns += NS_PER_S
                    self._line(now_ns, start_ns)
                self._step(now_ns, end_ns, next_line_ns)
            self._drain_rest()
        if (farewell := self._media.rtp.goodbye(self._clock.ntp)) is not None:
            self._send(farewell, control=True)
        return self._report(start_ns)

    def _step(self, now_ns: int, end_ns: int | None, next_line_ns: int) -> None:
        media = self._media
        self._hear()
        due = (
            media.pacer.poll_timeout(),
            media.rtp.poll_timeout(),
            media.poll_timeout(),
            end_ns,
            next_line_ns,
        )
        until_ns = min(instant for instant in due if instant is not None)
        timeout_ns = min(max(until_ns - now_ns, 0), _LONGEST_WAIT_NS)
        stamp = media.step(timeout_ns)
        if stamp is not None:
            self._queued.append(_Unit(stamp.capture_ns, media.rtp.packets_sent))
        self._transmit()

    def _hear(self) -> None:
        # The answer to an earlier datagram that nobody took is no feedback.
        with suppress(BlockingIOError, ConnectionError):
            while True:
                datagram = self._socket.recv(_FEEDBACK_OCTETS, socket.MSG_DONTWAIT)
                self._media.handle_feedback(datagram)

    def _transmit(self) -> None:
        media = self._media
        while (packet := media.pacer.poll_transmit(self._clock.now_ns())) is not None:
            self._send(packet)
        now_ns = self._clock.now_ns()
        while self._queued and self._queued[0].last_packet <= media.pacer.released_packets:
            self._sent_ns.add(now_ns - self._queued.pop(0).capture_ns)
            self._units_sent += 1
        if (report := media.rtp.poll_report(now_ns, self._clock.ntp)) is not None:
            self._send(report, control=True)

    def _drain_rest(self) -> None:
        """Send what is queued, so that the last picture is whole; for a second at most."""
        give_up_ns = self._clock.now_ns() + NS_PER_S
        while (due_ns := self._media.pacer.poll_timeout()) is not None and due_ns < give_up_ns:
            self._clock.sleep_until_ns(due_ns)
            self._transmit()

    def _send(self, datagram: bytes, *, control: bool = False) -> None:
        host, port = self._address
        try:
            self._socket.sendto(datagram, (host, port + control))
        except OSError:
            # A network that goes down and comes back is loss to the receiver, no end to the sender.
            self._send_errors += 1

    def _line(self, now_ns: int, start_ns: int) -> None:
        media = self._media
        print(
            f"{(now_ns - start_ns) / NS_PER_S:6.0f} s  {media.captured} captured, "
            f"{self._units_sent} sent in {media.pacer.released_packets} packets, "
            f"{media.pacer.released.mean_bps(now_ns) / 1000:.1f} of "
            f"{media.pacer.cap_bps / 1000:g} kbit/s, "
            f"capture to sent {self._sent_ns.percentile(95) / NS_PER_MS:.1f} ms (95 %)",
            flush=True,
        )

    def _report(self, start_ns: int) -> dict[str, Any]:
        media, now_ns = self._media, self._clock.now_ns()
        released = media.pacer.released
        report: dict[str, Any] = {
            "stream": media.kind,
            "seconds": (now_ns - start_ns) / NS_PER_S,
            "cap_bps": media.pacer.cap_bps,
            "payload_bps_mean": released.mean_bps(),
            "payload_bps_max_1s": released.max_bps(NS_PER_S),
            "payload_bps_max_100ms": released.max_bps(100 * NS_PER_MS),
            "frames_captured": media.captured,
            "frames_encoded": media.encoded,
            "frames_sent": self._units_sent,
            "pictures_refused": media.refused,
            "rtp_packets": media.pacer.released_packets,
            "rtp_payload_octets": released.octets,
            "send_errors": self._send_errors,
            "latency_ms": {
                "stages": {
                    "capture_to_encoded": media.encode_ns.summary_ms(),
                    "capture_to_sent": self._sent_ns.summary_ms(),
                }
            },
            "source": {"faults": media.source.faults, "last_fault": media.source.last_fault},
            "cpu_s": time.process_time(),
        }
        if isinstance(media, VideoOut):
            report |= {"size": media.size, "coded_size": media.coded_size}
        failed = []
        if not self._units_sent:
            failed.append(
                f"nothing was captured: {media.source.last_fault or 'the source is mute'}"
            )
        if report["payload_bps_max_1s"] > media.pacer.cap_bps:
            failed.append("the cap was broken")
        if self._send_errors:
            failed.append(f"{self._send_errors} datagrams could not be sent")
        report["failed"] = failed
        return report
