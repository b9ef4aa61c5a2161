"""CPU time of a slot: building a frame at one end, reading it at the other."""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_US, MonotonicClock
from kontur_av.meters import Histogram
from pipelines.bench.link.virtual import FILE, FLOWS, VIDEO, VOICE, Talker
from pipelines.report.result import Percentiles
from telepresence.link.flows import Level
from telepresence.link.profile import LinkProfile
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

#: The first slots fill caches.
_WARM_UP_SLOTS = 500


@dataclass(frozen=True, slots=True)
class SlotCost:
    """Time in `LinkSender.poll_transmit` and in `LinkReceiver.handle_frame`, per slot."""

    send_us: Percentiles
    receive_us: Percentiles


def slot_cost(profile: LinkProfile, *, slots: int, busy: bool) -> SlotCost:
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
    return SlotCost(_times(send), _times(receive))


def _times(histogram: Histogram) -> Percentiles:
    p50, p95, p99 = (round(histogram.percentile(p) / NS_PER_US, 2) for p in (50, 95, 99))
    return Percentiles(p50, p95, p99, round(histogram.max / NS_PER_US, 2))
