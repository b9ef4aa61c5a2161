"""Any octets: nothing of PUS and K2ACI raises anything but ProtocolError, and what is read packs
to the same octets.
"""

from binascii import crc_hqx
from contextlib import suppress
from random import Random

from common import first_seed, repeats
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
from telepresence.tmtc.k2aci import K2aciEndpoint, pack_body, parse_body
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet, parse_packet

S = 1_000_000_000


def telecommands():
    """Seeds: one of each service, for the joystick of the dictionary."""
    messages = [
        (3, 5, b"\x01\x01"), (3, 6, b"\x02\x01\x02"), (3, 27, b"\x01\x01"), (5, 6, b"\x01\x01"),
        (8, 1, b"\x04"), (12, 2, b"\x01\x01"), (17, 1, b""), (19, 4, b"\x01\x03"),
        (20, 1, b"\x02\x01\x05"), (20, 3, b"\x01\x05\x41\x20\x00\x00"),
    ]  # fmt: skip
    for count, (service, subtype, data) in enumerate(messages):
        fields = {"service": service, "subtype": subtype, "data": data, "count": count}
        yield pack_packet(Telecommand(apid=0x120, source=1, **fields))


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
        fields = {"service": service, "subtype": subtype, "data": data, "count": count}
        apid, to = (0x122, 0x132) if service == 129 else (0x120, service == 1)
        yield pack_packet(Telemetry(apid=apid, destination=to, **fields))


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
    body = octets[:4] + (len(octets) - 7).to_bytes(2, "big") + octets[6:-2]
    return body + crc_hqx(body, 0xFFFF).to_bytes(2, "big")


def end(segment):
    return TmtcEnd(segment, built_in_dictionary(), now_ns=0, first_count=5, boot_id=1)


def drain(one, now_ns):
    """Fetch all that an end has to say; its telecommands and reports can be read."""
    for octets in iter(lambda: one.poll_transmit(now_ns), None):
        parse_packet(octets)
    list(iter(one.next_event, None))


def test_mutated_packets_raise_nothing_else():
    random, seeds, read = Random(first_seed()), [*telecommands(), *telemetry()], 0
    ends, mutations = [end(segment) for segment in Segment], repeats(3000)
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
                drain(one, count * S // 100)
    assert read > mutations // 15


def test_mutated_requests_raise_nothing_else():
    random, seeds, one, read = Random(first_seed(2)), list(requests()), end(Segment.SPACE), 0
    for count in range(repeats(1000)):
        octets = mutate(random, random.choice(seeds))
        if (request := unpack_request(octets)) is not None:
            read += 1
            with suppress(ConfigError):
                one.handle_request(request, count * S // 100)
        if count % 16 == 0:
            drain(one, count * S // 100)
    assert read > 20


def test_mutated_telemetry_leaves_the_user_usable():
    """After any packets a telecommand is still verified."""
    random, ends = Random(first_seed(3)), Ends()
    ends.user.ping("oven", now_ns=0)
    ends.step()
    seeds = list(ends.telemetry)
    for _ in range(repeats(200)):
        octets = checked(mutate(random, random.choice(seeds)))
        ends.ground.handle_packet(octets, 0)
        ends.space.handle_packet(octets, 0)
    ends.events()
    ends.user.ping("oven", now_ns=ends.now_ns)
    ends.run(S)
    assert [event.ok for event in ends.events() if hasattr(event, "ok")] == [True]


def test_mutated_bodies_of_k2aci_are_refused_or_pack_to_the_same_octets():
    random, endpoint, read = Random(first_seed()), K2aciEndpoint(boot_id=1), 0
    for count in range(repeats(5000)):
        octets = mutate(random, random.choice(K2ACI_BODIES))
        try:
            assert pack_body(parse_body(octets)) == octets
            read += 1
        except ProtocolError:
            pass
        if count % 10 == 0:
            endpoint.handle_message(octets, count)
            list(iter(endpoint.next_event, None))
    assert read > 100
