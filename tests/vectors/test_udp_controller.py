"""The datagrams to and from a controller by UDP, octet by octet.

The codes were computed with `openssl dgst -sha256 -mac HMAC`, too.
"""

import pytest

from kontur_av.errors import ProtocolError
from telepresence.haptics.udp_protocol import (
    NO_FORCE,
    UdpCapabilities,
    UdpReading,
    UdpRole,
    code_of,
    is_authentic,
    pack_command,
    pack_hello,
    parse_reading,
    parse_welcome,
    session_keys,
)

KEY = bytes(range(32))
OWN, PEER = bytes(range(0x40, 0x50)), bytes(range(0x80, 0x90))
COMMANDS = bytes.fromhex("e5d3e4c815ef891202b4aa85bb44736e8731ac5a447af4f656c9d2444f5b06b0")
READINGS = bytes.fromhex("cb22a019f426d4fed9d5cadf55e1361b269eb72e4175190a427b5fc2ff683531")
HELLO = bytes.fromhex(
    "01 01 02 01"  # version, kind, axes, a robot
    "404142434445464748494a4b4c4d4e4f"
    "f93fbf4774c4ab745034f2e5e5c4632a"
)
WELCOME = bytes.fromhex(
    "01 02 02 00"  # it takes forces
    "404142434445464748494a4b4c4d4e4f 808182838485868788898a8b8c8d8e8f"
    "41c80000 3f000000 00000000 00000000 00000000 04 02"  # 25 N, 0.5 m/s
    "3e19999a 3dcccccd"  # 0.15 m, 0.1 m
    "41726d20c3a9"  # "Arm é"
    "d7dbdd13b174a5b550734e653310cb7f"
)
#: The same robot, without buttons; it measures no force.
UNFELT = WELCOME[:56] + bytes([NO_FORCE, 0]) + WELCOME[58:-16]
UNFELT += bytes.fromhex("8bee617dfa32cbced831dceb6e65d5f7")
COMMAND = bytes.fromhex(
    "01 03 02 02"  # active
    "0000000000000102 0000 0000"
    "3fc00000 00000000 00000000 be800000 00000000 00000000"  # 1.5 N, -0.25 N
    "c4553529253d957761efee9519d00393"
)
READING = bytes.fromhex(
    "01 04 02 01"  # contact
    "0000000000000103 0000000000000102 0003 0007 42120000"  # error 7, 36.5 °C
    "3d800000 bf000000 c1400000 3d000000 3e800000 00000000"  # 0.0625 m, -0.5 m/s, -12 N
    "686f74"  # "hot"
    "d38e2be8d397d622b2e5c4077da0350b"
)
MEASURED = UdpReading(
    259, 258, True, False, 3, 7, "hot", 36.5, (0.0625, -0.5, -12.0, 0.03125, 0.25, 0.0)
)


def test_golden():
    assert session_keys(KEY, OWN, PEER) == (COMMANDS, READINGS)
    assert pack_hello(UdpRole.ROBOT, OWN, KEY) == HELLO
    nonce, capabilities = parse_welcome(WELCOME, OWN)
    assert nonce == PEER
    half_m = (pytest.approx(0.15), pytest.approx(0.1))
    assert capabilities == UdpCapabilities("Arm é", False, 25.0, 0.5, 0.0, 0.0, 0.0, 4, 2, half_m)
    assert pack_command(258, 2, 0, (1.5, 0.0, 0.0, -0.25, 0.0, 0.0), COMMANDS) == COMMAND
    assert parse_reading(READING) == MEASURED
    assert parse_welcome(UNFELT, OWN)[1] == capabilities._replace(buttons=NO_FORCE, leds=0)
    for datagram, key in ((WELCOME, KEY), (UNFELT, KEY), (READING, READINGS)):
        assert is_authentic(datagram, key)
        assert not is_authentic(datagram, COMMANDS)


def changed(datagram, at, octets):
    """With other octets; the code is not looked at here."""
    return datagram[:at] + octets + datagram[at + len(octets) :]


@pytest.mark.parametrize(
    ("parse", "datagram"),
    [
        (parse_reading, changed(READING, 0, b"\x02")),  # another version
        (parse_reading, changed(READING, 1, b"\x03")),  # another kind
        (parse_reading, changed(READING, 2, b"\x03")),  # three axes
        (parse_reading, changed(READING, 3, b"\x04")),  # a bit that has no meaning
        (parse_reading, READING[:60]),
        (parse_reading, READING[:52] + b"x" * 81 + bytes(16)),  # too long a text
        (parse_reading, changed(READING, 28, b"\x7f\x80\x00\x00")),  # an infinite place
        (lambda data: parse_welcome(data, OWN), changed(WELCOME, 2, b"\x06")),
        (lambda data: parse_welcome(data, OWN), changed(WELCOME, 3, b"\x02")),
        (lambda data: parse_welcome(data, OWN), changed(WELCOME, 36, b"\x7f\xc0\x00\x00")),
        (lambda data: parse_welcome(data, OWN), changed(WELCOME, 58, b"\x00\x00\x00\x00")),
        (lambda data: parse_welcome(data, OWN), WELCOME[:70]),
    ],
)
def test_what_does_not_fit_is_refused(parse, datagram):
    with pytest.raises(ProtocolError):
        parse(datagram)


def test_no_thermometer_and_an_older_hello_are_none():
    assert parse_reading(changed(READING, 24, b"\x7f\xc0\x00\x00")).temperature_c is None
    assert parse_welcome(WELCOME, PEER) is None
    assert code_of(b"", bytes(32)).hex() == "b613679a0814d9ec772f95d778c35fc5"
