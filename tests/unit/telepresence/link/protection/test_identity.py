import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from telepresence.link.protection.identity import MachineIdentity, MachineKey

KEY = MachineKey.from_seed(bytes(32))


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
    ("text", "mend"),
    [
        ("", "copy the line"),
        ("ABCDE", "5 characters instead of 35"),
        (str(KEY.identity) + "A", "36 characters"),
        ("9" * 35, "A to Z"),
        ("Ä" * 35, "A to Z"),
    ],
)
def test_what_is_no_identity_is_refused_with_the_mend(text, mend):
    with pytest.raises(ConfigError, match=mend):
        MachineIdentity.parse(text)


def test_a_key_survives_its_file_and_shows_only_its_identity():
    read = MachineKey.from_pem(KEY.to_pem())
    assert read.identity == KEY.identity
    assert repr(read) == f"MachineKey({KEY.identity})"


def test_other_keys_and_garbage_are_refused_without_a_quotation():
    other = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    locked = KEY.private.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(b"word"),
    )
    for octets in (other, locked, b"", b"secret words", KEY.to_pem()[:-40]):
        with pytest.raises(ValueError) as caught:
            MachineKey.from_pem(octets)
        assert "secret" not in str(caught.value) and caught.value.__cause__ is None


def test_the_certificate_is_the_same_each_time():
    assert KEY.certificate() == KEY.certificate()
