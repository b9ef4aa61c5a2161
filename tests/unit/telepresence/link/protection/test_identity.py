"""An identity as a person types it, and a key in its file."""

from hashlib import sha256

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from telepresence.link.protection.identity import MachineIdentity, MachineKey

KEY = MachineKey.from_seed(bytes(32))
#: RFC 8032 section 7.1, test 1: seed and public key.
SEED = bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
PUBLIC = bytes.fromhex("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a")


def test_the_identity_of_a_known_key():
    # RFC 8410 section 4: what comes before an Ed25519 key in a SubjectPublicKeyInfo.
    info = bytes.fromhex("302a300506032b6570032100") + PUBLIC
    identity = MachineKey.from_seed(SEED).identity
    assert identity.digest == sha256(info).digest()[:20]
    assert str(identity) == "A3R73-D62FG-5WBK2-ZKV66-MHW3B-LWNWI-YR3FG"


@given(st.binary(min_size=20, max_size=20))
def test_an_identity_is_read_as_a_person_may_type_it(digest):
    identity = MachineIdentity(digest)
    text = str(identity)
    assert len(text) == 41 and text.count("-") == 6
    spoken = text.replace("-", " ").replace("O", "0").replace("I", "1").replace("B", "8")
    assert MachineIdentity.parse(f" {spoken.lower()}\n") == identity


def test_two_exchanged_or_one_wrong_character_are_noticed():
    text = str(KEY.identity).replace("-", "")
    for place in range(len(text)):
        swapped = text[:place] + text[place : place + 2][::-1] + text[place + 2 :]
        wrong = text[:place] + ("A" if text[place] != "A" else "C") + text[place + 1 :]
        for mistyped in {swapped, wrong} - {text}:
            with pytest.raises(ConfigError, match="mistyped"):
                MachineIdentity.parse(mistyped)


@pytest.mark.parametrize(
    ("text", "fix"),
    [
        ("", "copy the line"),
        ("ABCDE", "5 characters instead of 35"),
        (str(KEY.identity) + "A", "36 characters"),
        ("9" * 35, "A to Z"),
        ("Ä" * 35, "A to Z"),
    ],
)
def test_what_is_no_identity_is_refused_with_the_mend(text, fix):
    with pytest.raises(ConfigError, match=fix):
        MachineIdentity.parse(text)


def test_an_identity_has_twenty_octets():
    for octets in (19, 21):
        with pytest.raises(ValueError, match=f"an identity of {octets} octets"):
            MachineIdentity(bytes(octets))


def test_a_key_survives_its_file_and_shows_only_its_identity():
    read = MachineKey.from_pem(KEY.to_pem())
    assert read.identity == KEY.identity
    assert repr(read) == f"MachineKey({KEY.identity})"
    assert KEY.certificate() == KEY.certificate()


def test_other_keys_and_garbage_are_refused_without_a_quotation():
    other = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    locked = KEY.private.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(b"word"),
    )
    for octets in (other, locked, b"", b"secret words", KEY.to_pem()[:-40]):
        with pytest.raises(ValueError, match="key") as caught:
            MachineKey.from_pem(octets)
        assert "secret" not in str(caught.value) and caught.value.__cause__ is None
