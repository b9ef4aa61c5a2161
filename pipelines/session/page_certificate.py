"""The certificate of pages that other machines may open: a given one, or one made for a session.

Browsers give microphone, camera and decoder to pages of 127.0.0.1 and to pages over TLS only.
`cryptography` is imported only where a certificate is needed.
"""

import ssl
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING

from kontur_av.errors import ConfigError
from pipelines.session.page_sockets import PageHost

if TYPE_CHECKING:
    from cryptography import x509

#: Apple's browsers refuse a certificate that is valid for longer than 825 days.
_VALID = timedelta(days=365)
#: A browser's clock may be behind.
_EARLIER = timedelta(days=1)


def check_certificate(path: Path) -> None:
    """Raise ConfigError if `path` is no PEM file with a valid certificate and its key."""
    from cryptography import x509

    try:
        data = path.read_bytes()
    except OSError as error:
        raise _refused(path, f"cannot be read: {error.strerror}") from None
    try:
        first = x509.load_pem_x509_certificates(data)[0]
    except ValueError:
        raise _refused(path, "has no certificate in PEM form") from None
    if b"PRIVATE KEY-----" not in data:
        raise _refused(path, "has no private key: append it to the certificate")
    if b"ENCRYPTED" in data:
        raise _refused(path, "has a key with a password: take the password off")
    now = datetime.now(UTC)
    if now > first.not_valid_after_utc:
        raise _refused(path, f"expired on {first.not_valid_after_utc:%Y-%m-%d}: take a new one")
    if now < first.not_valid_before_utc:
        raise _refused(path, f"is valid only from {first.not_valid_before_utc:%Y-%m-%d} on")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(path)
    except (ssl.SSLError, ValueError, OSError):
        raise _refused(path, "has a key that does not belong to the certificate") from None


def make_certificate(path: Path, names: Iterable[str]) -> None:
    """Write a self-signed certificate with its key to the new file `path`, for its owner only.

    ECDSA on P-256, for the host names and IP addresses `names`.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    hosts = list(names)
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "kontur-av session")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(now + _VALID)
        .add_extension(
            x509.SubjectAlternativeName([_general_name(host) for host in hosts]), critical=False
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([x509.oid.ExtendedKeyUsageOID.SERVER_AUTH]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    path.touch(0o600, exist_ok=False)
    path.write_bytes(made.public_bytes(serialization.Encoding.PEM) + secret)


def certificate_for(host: PageHost, own: Path | None, new: Path) -> tuple[Path | None, str]:
    """Return the certificate for pages on a host: the user's own, or a new file `new`.

    None: they need none. The text is the fingerprint of a new one, else "".
    """
    if own is not None or host.is_loopback:
        return own, ""
    make_certificate(new, host.names())
    return new, fingerprint(new)


def fingerprint(path: Path) -> str:
    """Return the SHA-256 fingerprint of the first certificate in `path`, as browsers show it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    first = x509.load_pem_x509_certificates(path.read_bytes())[0]
    return first.fingerprint(hashes.SHA256()).hex(":").upper()


def _general_name(host: str) -> "x509.GeneralName":
    from cryptography import x509

    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _refused(path: Path, why: str) -> ConfigError:
    return ConfigError(f"--page-cert {path}: {why}")
