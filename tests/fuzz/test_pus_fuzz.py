"""Any octets: nothing of PUS raises anything but ProtocolError or ConfigError, and packets that
are read pack to the same octets.

`KONTUR_FUZZ_PACKETS=1000000 pytest tests/fuzz/test_pus_fuzz.py` runs that many mutations.
"""

import os
from random import Random

import pytest
from mutated_octets import K2ACI_BODIES, mutate
from pus_ends import Ends

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import (
    FunctionDone,
    RaiseEvent,
    SendCommand,
    SendK2aci,
    SetValues,
    pack_request,
    unpack_request,
)
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet, parse_packet

MUTATIONS = int(os.environ.get("KONTUR_FUZZ_PACKETS", "4000"))
S = 1_000_000_000


def telecommands():
    """Seeds: one of each service, for the joystick of the dictionary."""
    messages = [
        (3, 5, b"\x01\x01"), (3, 6, b"\x02\x01\x02"), (3, 27, b"\x01\x01"), (5, 6, b"\x01\x01"),
        (8, 1, b"\x04"), (12, 2, b"\x01\x01"), (17, 1, b""), (19, 4, b"\x01\x03"),
        (20, 1, b"\x02\x01\x05"), (20, 3, b"\x01\x05\x41\x20\x00\x00"),
    ]  # fmt: skip
    for count, (service, subtype, data) in enumerate(messages):
        yield pack_packet(
            Telecommand(
                apid=0x120, count=count, service=service, subtype=subtype, data=data, source=1
            )
        )


def telemetry():
    """Seeds: one of each report, and K2ACI in its private service."""
    messages = [
        (1, 1, b"\x19\x20\xc0\x05"), (1, 8, b"\x19\x20\xc0\x05\x04no"),
        (1, 10, b"\x19\x20\xc0\x05\x01x"),
        (3, 25, b"\x01\x03\x01\x01\x2e\xe0\x41\xb8\x00\x00"), (5, 1, b"\x01\x04"),
        (5, 4, b"\x03\x42\xa2\x00\x00"), (17, 2, b""), (20, 2, b"\x01\x01\x03"),
    ]  # fmt: skip
    messages += [(129, 1, body) for body in K2ACI_BODIES]
    for count, (service, subtype, data) in enumerate(messages):
        k2aci = service == 129
        yield pack_packet(
            Telemetry(
                apid=0x122 if k2aci else 0x120,
                count=count,
                service=service,
                subtype=subtype,
                data=data,
                destination=0x132 if k2aci else service == 1,
            )
        )


def requests():
    """Seeds: what processes ask an end for."""
    yield from map(
        pack_request,
        [
            SetValues("joystick", {"state": "halted", "temperature": 20.0, "dead_man": True}),
            RaiseEvent("joystick", "cooled"),
            SendCommand("a", 1, "joystick", "call", "halt"),
            SendCommand("a", 2, "joystick", "parameters", arguments=("state", "x")),
            SendCommand("a", 3, "robot", "set", values={"x": 1}),
            FunctionDone("joystick", 0, "no"),
            SendK2aci("a", 1, "Chat", {"sender": "cosmonaut", "text": "hello"}),
            SendK2aci("a", 2, "TaskSelected", {"task": "a", "run": 1, "start_um": (1, 2)}),
        ],
    )


def checked(octets):
    """The packet with a right length and check, so that what is behind them is reached."""
    if len(octets) < 8:
        return octets
    body = bytearray(octets[:-2])
    body[4:6] = (len(octets) - 7).to_bytes(2, "big")
    register = 0xFFFF
    for octet in body:
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ (0x1021 if register & 0x8000 else 0)) & 0xFFFF
    return bytes(body) + register.to_bytes(2, "big")


def end(segment):
    return TmtcEnd(segment, built_in_dictionary(), now_ns=0, first_count=5, life=1)


def drain(one, now_ns):
    """Fetch all that an end has to say; its telecommands and reports can be read."""
    while (octets := one.poll_transmit(now_ns)) is not None:
        parse_packet(octets)
    while one.next_event() is not None:
        pass


def run_packets(mutations, seed):
    """Return how many mutated packets could be read."""
    random = Random(seed)
    seeds = [*telecommands(), *telemetry()]
    ends = [end(segment) for segment in Segment]
    read = 0
    for count in range(mutations):
        octets = mutate(random, random.choice(seeds))
        if random.random() < 0.7:
            octets = checked(octets)
        try:
            assert pack_packet(parse_packet(octets)) == octets
            read += 1
        except ProtocolError:
            pass
        for one in ends:
            one.handle_packet(octets, count * S // 100)
        if count % 16 == 0:
            for one in ends:
                drain(one, count * S // 100)
    return read


def run_requests(mutations, seed):
    """Return how many mutated requests could be read."""
    random = Random(seed)
    seeds = list(requests())
    one = end(Segment.SPACE)
    read = 0
    for count in range(mutations):
        octets = mutate(random, random.choice(seeds))
        read += unpack_request(octets) is not None
        one.handle_octets(octets, count * S // 100)
        if count % 16 == 0:
            drain(one, count * S // 100)
    return read


def test_mutated_packets_raise_nothing_else():
    assert run_packets(MUTATIONS * 3 // 4, seed=1) > MUTATIONS // 20


def test_mutated_requests_raise_nothing_else():
    assert run_requests(MUTATIONS // 4, seed=2) > MUTATIONS // 200


def test_mutated_telemetry_leaves_the_user_usable():
    """After any packets a telecommand is still verified."""
    random, ends = Random(3), Ends()
    ends.user.ping("oven", now_ns=0)
    ends.step()
    seeds = list(ends.telemetry)
    ends.events()
    for _ in range(MUTATIONS // 20):
        octets = checked(mutate(random, random.choice(seeds)))
        ends.ground.handle_packet(octets, 0)
        ends.space.handle_packet(octets, 0)
    ends.events()
    ends.user.ping("oven", now_ns=ends.now_ns)
    ends.run(S)
    assert [one.ok for one in ends.events() if hasattr(one, "ok")] == [True]


@pytest.mark.parametrize("octets", [b"\x00" * 7, b"\x19\x20\xc0\x00\x00\x00" + b"\xff" * 300])
def test_packets_of_no_possible_length_are_refused(octets):
    with pytest.raises((ProtocolError, ConfigError)):
        parse_packet(octets)
