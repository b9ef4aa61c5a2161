"""Put your own UDP traffic through the 1 ms slots, on virtual time: no sockets, no waiting.

Run it: python samples/slots_virtual_time.py [seconds]
It prints, for each flow, how long its packets waited and what each octet of the link was used for.
"""

import struct
import sys
from collections import defaultdict

from kontur_av.clock import NS_PER_MS, ManualClock
from telepresence import (
    UPLINK,
    HapticReceived,
    Level,
    LinkReceiver,
    LinkSender,
    packet_flow,
    video_flow,
    voice_flow,
)

# A flow is a UDP port at each end of the link. Both ends have the same table.
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    packet_flow("telecommands", Level.TMTC),
    packet_flow("file", Level.MAINTENANCE),
]


def rtp(payload_type: int, sequence: int, timestamp: int, payload: bytes) -> bytes:
    return struct.pack(">BBHII", 0x80, payload_type, sequence, timestamp, 1) + payload


def traffic(slot: int) -> list[tuple[str, bytes]]:
    """What your programs send in this millisecond, as (flow, UDP payload). Put your own here."""
    datagrams = []
    if slot % 33 == 0:
        datagrams.append(("video", rtp(96, slot // 33, slot * 90, bytes(350))))
    if slot % 20 == 0:
        datagrams.append(("voice", rtp(97, slot // 20, slot // 20 * 960, bytes(20))))
    if slot % 500 == 250:
        datagrams.append(("telecommands", b"select camera 2"))
    if slot % 1000 == 0:
        datagrams.append(("file", bytes(20)))
    return datagrams


def main(seconds: int) -> None:
    clock = ManualClock()
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    sent_ns = defaultdict(list)
    delays_ms = defaultdict(list)
    samples = 0
    for slot in range(seconds * 1000):
        now_ns = clock.now_ns()
        sender.handle_haptic(struct.pack(">Q4x", slot), now_ns)
        for flow, datagram in traffic(slot):
            if sender.handle_packet(flow, datagram, now_ns):
                sent_ns[flow].append(now_ns)
        frame = sender.poll_transmit(now_ns)
        # A frame is at the other end when its slot is over.
        now_ns = clock.advance_ns(UPLINK.slot_ns)
        receiver.handle_frame(frame, now_ns)
        while event := receiver.next_event():
            if isinstance(event, HapticReceived):
                samples += 1
            else:
                name = event.flow.name
                # Nothing is lost here, so the n-th packet out is the n-th that was put in.
                sent = sent_ns[name][len(delays_ms[name])]
                delays_ms[name].append((event.now_ns - sent) / NS_PER_MS)

    print(f"haptic samples received: {samples} in {seconds * 1000} slots")
    print(f"{'flow':14}{'packets':>8}{'mean ms':>9}{'max ms':>8}")
    for name, delays in delays_ms.items():
        mean = sum(delays) / len(delays)
        print(f"{name:14}{len(delays):8}{mean:9.1f}{max(delays):8.1f}")
    octets = sender.octets()
    for kind, number in octets.items():
        print(f"{kind:14}{number:10} octets {100 * number / sum(octets.values()):6.2f} %")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
