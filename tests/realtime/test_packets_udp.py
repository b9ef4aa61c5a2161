"""Space's view by UDP: packets and frames to another ground system, and its telecommands."""

import contextlib
import socket
import struct
import threading

from common import free_port
from running_end import RunningEnd
from running_session import BOARD, eventually, free_pair

from telepresence.link.frame import FrameCodec
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet, parse_packet
from telepresence.tmtc.pus.verification import SERVICE, parse_verification

DICTIONARY = built_in_dictionary()
#: Of a user of another ground system in space.
SOURCE = 4


class Listener:
    """Keeps all datagrams of a port. A context manager."""

    def __init__(self, port):
        self.came = []
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("127.0.0.1", port))
        self.udp.settimeout(0.2)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        # Of SO_MEMINFO: what found the socket full.
        self.dropped = struct.unpack("9I", self.udp.getsockopt(socket.SOL_SOCKET, 55, 36))[8]
        self.udp.close()

    def _read(self):
        while True:
            try:
                self.came.append(self.udp.recv(2048))
            except TimeoutError:
                if self._ended.is_set():
                    return


def telecommand(application, count, *, function=None):
    """Are-you-alive, or a function without arguments."""
    table = DICTIONARY.application(application)
    kind = (17, b"") if function is None else (8, bytes([table.function(function).number]))
    service, data = kind
    return Telecommand(
        apid=table.apid, count=count, service=service, subtype=1, data=data, source=SOURCE
    )


def is_told(packets, command, subtype):
    """Whether a report with this subtype is about this telecommand."""
    for packet in map(parse_packet, packets):
        if isinstance(packet, Telemetry) and packet.service == SERVICE:
            about = parse_verification(packet.subtype, packet.data)
            seen = (about.apid, about.count, packet.destination, packet.subtype)
            if seen == (command.apid, command.count, SOURCE, subtype):
                return True
    return False


def test_space_gives_packets_and_frames_by_udp_and_takes_telecommands(tmp_path):
    path, packets, frames = free_port(), free_pair(), free_pair()
    near = ("--listen", f"127.0.0.1:{path}", "--insecure")
    far = ("--peer", f"127.0.0.1:{path}", "--insecure")
    outside = ("--packets", f"udp:127.0.0.1:{packets}", "--packets-allow", "joystick.halt")
    asked = [
        (telecommand("joystick", 0), 7),  # here
        (telecommand("robot", 1), 7),  # across the radio
        (telecommand("joystick", 2, function="halt"), 7),
        (telecommand("robot", 3, function="power_off"), 2),  # not allowed
    ]
    with contextlib.ExitStack() as stack:
        telemetry, down, up = (
            stack.enter_context(Listener(port)) for port in (packets, frames, frames + 1)
        )
        ground = stack.enter_context(
            RunningEnd(BOARD, "ground", *near, directory=tmp_path / "ground")
        )
        # It has its ports, so that the other end takes others.
        ground.pids()
        space = stack.enter_context(
            RunningEnd(
                *(BOARD, "space", *far, *outside, "--frames", f"udp:127.0.0.1:{frames}"),
                directory=tmp_path / "space",
            )
        )
        ground.wait_for_flow()
        eventually(lambda: telemetry.came, "telemetry, of a process that has its port")
        for command, end in asked:
            telemetry.udp.sendto(pack_packet(command), ("127.0.0.1", packets + 1))
            eventually(
                lambda command=command, end=end: is_told([*telemetry.came], command, end),
                f"report {end} about {command}",
            )
        for listener in (down, up):
            eventually(lambda one=listener: len(one.came) > 1000, "a thousand frames")
        space_code, in_space = space.interrupt()
        ground_code, _ = ground.interrupt()
    assert space_code == ground_code == 0
    told = in_space["processes"]["packets"]["counts"]
    assert (told["outside_commands"], told["outside_refused"]) == (3, 1)
    assert told["outside_garbage"] == told["outside_excess"] == told["outside_dropped"] == 0
    # The refusal is the bridge's own.
    assert len(telemetry.came) + telemetry.dropped == told["outside_packets"] + 1
    told = in_space["processes"]["frames"]["counts"]
    for profile, listener in ((DOWNLINK, down), (UPLINK, up)):
        codec = FrameCodec(profile)
        assert all(isinstance(codec.parse(one), tuple) for one in listener.came)
        assert len(listener.came) + listener.dropped == told[f"copied_{profile.name}"]
        # A process that was stalled misses some.
        assert told["copies_missed"] < len(listener.came)
    assert told["copies_unsent"] == 0
