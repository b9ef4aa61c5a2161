"""A machine's key pair, and the identity by which another machine pins it.

The identity is the first 160 bits of the SHA-256 of the public key (SubjectPublicKeyInfo, RFC 5280
section 4.1), in base32 (RFC 4648 section 6), with a check of three characters: seven groups of
five, short enough for the telephone. To make another key with the same identity takes 2^160 tries.
"""

from base64 import b32decode, b32encode
from dataclasses import dataclass
from datetime import datetime
from hashlib import sha256

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from kontur_av.errors import ConfigError

_IDENTITY_OCTETS = 20
_GROUP = 5
_DIGITS = _IDENTITY_OCTETS * 8 // 5
_CHECK_DIGITS = 3
#: Digits that base32 does not have, and the letters for which they are taken on the telephone.
_MISREAD = str.maketrans("018", "OIB")
#: RFC 5280 section 4.1.2.5: a certificate without a well-defined end. Nobody looks at the dates.
_FIRST_DAY = datetime(1970, 1, 1)
_LAST_DAY = datetime(9999, 12, 31, 23, 59, 59)


@dataclass(frozen=True, slots=True)
class MachineIdentity:
    """The public identity of a machine. digest: 20 octets. `str()` gives its text."""

    digest: bytes

    def __post_init__(self) -> None:
        if len(self.digest) != _IDENTITY_OCTETS:
            raise ValueError(f"an identity of {len(self.digest)} octets")

    def __str__(self) -> str:
        digits = b32encode(self.digest).decode()
        whole = digits + _check(digits)
        return "-".join(whole[at : at + _GROUP] for at in range(0, len(whole), _GROUP))

    @classmethod
    def of(cls, public: Ed25519PublicKey) -> "MachineIdentity":
        """Return the identity of a public key."""
        info = public.public_bytes(
            serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
        )
        return cls(sha256(info).digest()[:_IDENTITY_OCTETS])

    @classmethod
    def parse(cls, text: str) -> "MachineIdentity":
        """Return the identity that a person typed; ConfigError if it is mistyped.

        Case, hyphens and spaces do not matter. 0, 1 and 8 are read as O, I and B.
        """
        digits = "".join(text.split()).replace("-", "").upper().translate(_MISREAD)
        if len(digits) != _DIGITS + _CHECK_DIGITS:
            raise ConfigError(
                f"identity {text!r} has {len(digits)} characters instead of "
                f"{_DIGITS + _CHECK_DIGITS}: copy the line of `kontur-av keys show`"
            )
        digits, check = digits[:_DIGITS], digits[_DIGITS:]
        try:
            digest = b32decode(digits)
        except ValueError:
            raise ConfigError(
                f"identity {text!r}: only the letters A to Z and the digits 2 to 7 stand in it"
            ) from None
        if check != _check(digits):
            raise ConfigError(f"identity {text!r} is mistyped: its check does not fit")
        return cls(digest)


class MachineKey:
    """A machine's private key (Ed25519, RFC 8032) with its identity. `repr` shows only this.

    private: for the handshake. identity: the identity of its public key.
    """

    def __init__(self, private: Ed25519PrivateKey) -> None:
        self.private = private
        self.identity = MachineIdentity.of(private.public_key())

    def __repr__(self) -> str:
        return f"MachineKey({self.identity})"

    @classmethod
    def from_seed(cls, seed: bytes) -> "MachineKey":
        """Return the key pair of 32 octets, which a shell draws for nothing else."""
        return cls(Ed25519PrivateKey.from_private_bytes(seed))

    @classmethod
    def from_pem(cls, octets: bytes) -> "MachineKey":
        """Return the key in a PEM file. Raises ValueError if there is none, or one of another kind.

        The message never quotes the file.
        """
        try:
            private = serialization.load_pem_private_key(octets, password=None)
        except (TypeError, ValueError):
            raise ValueError("no private key without a password in PEM") from None
        except Exception as error:
            # UnsupportedAlgorithm, whose text may name what the file has.
            raise ValueError(f"no usable key ({type(error).__name__})") from None
        if not isinstance(private, Ed25519PrivateKey):
            raise ValueError("a key of another kind than Ed25519")
        return cls(private)

    def to_pem(self) -> bytes:
        """Return the private key as unencrypted PKCS #8 in PEM, for a file of mode 0600."""
        return self.private.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )

    def certificate(self) -> x509.Certificate:
        """Return a self-made certificate; only its public key matters to the other end."""
        name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "kontur-av")])
        return (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(name)
            .public_key(self.private.public_key())
            .serial_number(1)
            .not_valid_before(_FIRST_DAY)
            .not_valid_after(_LAST_DAY)
            .sign(self.private, None)
        )


def _check(digits: str) -> str:
    return b32encode(sha256(digits.encode()).digest()).decode()[:_CHECK_DIGITS]
