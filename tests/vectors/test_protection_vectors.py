"""The datagrams of the protected channel, octet by octet."""

from hashlib import sha256

from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from telepresence.link.protection.datagrams import (
    DirectionKeys,
    HandshakeSegment,
    RecordOpener,
    RecordSealer,
    SegmentCodec,
)
from telepresence.link.protection.identity import MachineKey

#: RFC 8032 section 7.1, test 1: seed and public key.
SEED = bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
PUBLIC = bytes.fromhex("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a")


def test_the_identity_of_a_known_key():
    # RFC 8410 section 4: what comes before an Ed25519 key in a SubjectPublicKeyInfo.
    info = bytes.fromhex("302a300506032b6570032100") + PUBLIC
    identity = MachineKey.from_seed(SEED).identity
    assert identity.digest == sha256(info).digest()[:20]
    assert str(identity) == "A3R73-D62FG-5WBK2-ZKV66-MHW3B-LWNWI-YR3FG"


def test_two_records():
    keys = DirectionKeys(b"\xa1\xb2\xc3", bytes(range(32)), bytes(range(0x40, 0x4C)))
    sealer = RecordSealer(keys)
    first, second = sealer.seal(b"first frame"), sealer.seal(b"second")
    assert (
        first.hex() == "11a1b2c300000000000084d0dc50521ce171aca972412374f6f3f6687482c732149bd5e531"
    )
    assert second.hex() == "11a1b2c3000000000001166ddc5db66be4944961f8c3ab46e012cea55544b2a9"
    # The same from the parts that the document names.
    vector = bytes.fromhex("404142434445464748494a4a")
    head = bytes.fromhex("11a1b2c3000000000001")
    assert second == head + AESGCM(keys.key).encrypt(vector, b"second", head)
    opener = RecordOpener(keys)
    assert (opener.open(second), opener.open(first)) == (b"second", b"first frame")


def test_a_segment():
    ends = [MachineKey.from_seed(seed).identity for seed in (SEED, bytes(32))]
    segment = HandshakeSegment(True, b"\x01" * 8, b"\x02" * 8, 3, 4, b"data")
    assert SegmentCodec(*ends).pack(segment).hex() == (
        "1301010101010101010202020202020202000300046461746133694c68b3086d086674eee83a3b2848"
    )
