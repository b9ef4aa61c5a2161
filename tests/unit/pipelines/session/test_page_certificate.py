"""Certificates of pages: one is made for its owner only, and mistakes are named."""

import ssl
import stat
from datetime import datetime, timedelta
from ipaddress import ip_address

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from kontur_av.errors import ConfigError
from pipelines.session import page_sockets
from pipelines.session.page_sockets import check_certificate, fingerprint, make_certificate


@pytest.fixture
def made(tmp_path):
    path = tmp_path / "page.pem"
    make_certificate(path, ["192.0.2.7", "lab.example", "2001:db8::1"])
    return path


def test_a_made_certificate_is_valid_for_its_names_and_its_owners_alone(made):
    check_certificate(made)
    assert stat.S_IMODE(made.stat().st_mode) == 0o600
    read = x509.load_pem_x509_certificate(made.read_bytes())
    names = read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["lab.example"]
    assert names.get_values_for_type(x509.IPAddress) == [
        ip_address("192.0.2.7"),
        ip_address("2001:db8::1"),
    ]
    assert isinstance(read.public_key().curve, ec.SECP256R1)
    shown = ssl.PEM_cert_to_DER_cert(made.read_text().partition("-----BEGIN PRIVATE")[0])
    digest = hashes.Hash(hashes.SHA256())
    digest.update(shown)
    assert fingerprint(made).replace(":", "") == digest.finalize().hex().upper()


def test_a_file_is_never_overwritten(made):
    with pytest.raises(FileExistsError):
        make_certificate(made, ["localhost"])


def parts(path):
    """The PEM texts of certificate and key."""
    text = path.read_text()
    begin = text.index("-----BEGIN PRIVATE")
    return text[:begin], text[begin:]


def in_the_future(**by):
    class Clock(datetime):
        @classmethod
        def now(cls, zone):
            return datetime.now(zone) + timedelta(**by)

    return Clock


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (lambda certificate, key, other: "no PEM at all", "no certificate in PEM form"),
        (lambda certificate, key, other: key, "no certificate in PEM form"),
        (lambda certificate, key, other: certificate, "no private key"),
        (lambda certificate, key, other: certificate + other, "does not belong"),
        (
            lambda certificate, key, other: (
                certificate + key.replace("PRIVATE KEY", "ENCRYPTED PRIVATE KEY")
            ),
            "a key with a password",
        ),
    ],
)
def test_what_is_no_certificate_with_its_key_is_refused(made, tmp_path, text, says):
    make_certificate(tmp_path / "other.pem", ["localhost"])
    _, other = parts(tmp_path / "other.pem")
    wrong = tmp_path / "wrong.pem"
    wrong.write_text(text(*parts(made), other))
    with pytest.raises(ConfigError, match=f"--page-cert .*wrong.pem.*{says}"):
        check_certificate(wrong)


@pytest.mark.parametrize(
    ("by", "says"), [({"days": 400}, "expired on"), ({"days": -9}, "only from")]
)
def test_a_certificate_out_of_its_time_is_refused(made, monkeypatch, by, says):
    monkeypatch.setattr(page_sockets, "datetime", in_the_future(**by))
    with pytest.raises(ConfigError, match=says):
        check_certificate(made)
    monkeypatch.setattr(page_sockets, "datetime", in_the_future(days=300))
    check_certificate(made)
