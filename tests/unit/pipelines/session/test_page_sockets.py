"""Pages listen on the next free ports, know their names, and have a certificate of their own."""

import contextlib
import socket
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

SEATS = ("space", "ground")
LOOPBACK = page_sockets.PageHost()


def test_a_busy_port_gives_way_to_the_next_until_there_is_none(monkeypatch):
    with contextlib.ExitStack() as opened:
        held = opened.enter_context(socket.create_server(("127.0.0.1", 0)))
        port = held.getsockname()[1]
        if port > 65_000:
            pytest.skip("the system gave one of the last ports")
        # A second session takes ports behind those of the first.
        found = [port]
        for _ in range(2):
            sockets = page_sockets.bind_pages(LOOPBACK, port, SEATS)
            found += [opened.enter_context(sockets[seat]).getsockname()[1] for seat in SEATS]
        assert found == sorted(set(found))
        # A browser may connect before the process serves it.
        socket.create_connection(("127.0.0.1", found[1])).close()
        monkeypatch.setattr(page_sockets, "_MOST_PORTS", 1)
        with pytest.raises(ConfigError, match=f"TCP ports {port} to {port} are busy"):
            page_sockets.bind_pages(LOOPBACK, port, SEATS)


def test_both_pages_have_the_same_two_tokens():
    sockets = {seat: socket.socket() for seat in SEATS}
    pages = page_sockets.listeners(sockets, LOOPBACK, None)
    space, ground = pages["space"], pages["ground"]
    assert space.operator_token == ground.operator_token != space.viewer_token
    assert len(space.operator_token) >= 32
    assert space.url("space").startswith("http://127.0.0.1:")
    assert space.operator_token not in repr(space) and space.viewer_token not in repr(space)
    # The owner may hand out every role, and an end takes those of its own people.
    assert {*space.people} == {"cosmonaut", "experimenter", "supervisor", "systems"}
    assert space.people == ground.people and not any(map(repr(space).count, space.people.values()))
    assert {*space.role_tokens} == {"cosmonaut"} and space.ports == ground.ports
    again = page_sockets.listeners(sockets, LOOPBACK, None)
    assert again["space"].operator_token != space.operator_token
    for listener in sockets.values():
        listener.close()


def test_a_browser_may_ask_only_for_names_of_the_bound_address_and_loopback_needs_no_tls():
    assert LOOPBACK.names() == ("127.0.0.1", "localhost")
    for host, address, names in (
        ("Lab.Example", "192.0.2.7", ("lab.example", "192.0.2.7")),
        ("bücher.example", "192.0.2.7", ("xn--bcher-kva.example", "192.0.2.7")),
        ("lab", "127.0.1.1", ("127.0.1.1", "lab", "localhost")),
        ("::1", "::1", ("::1", "localhost")),
    ):
        assert page_sockets.PageHost(host=host, address=address).names() == names
    every = page_sockets.PageHost(host="0.0.0.0", address="0.0.0.0").names()
    assert {"127.0.0.1", "localhost", socket.gethostname().lower()} <= set(every)
    assert "0.0.0.0" not in every
    places = ("127.0.0.1", "127.3.2.1", "::1", "0.0.0.0", "192.0.2.7")
    found = [page_sockets.PageHost(host=at, address=at).is_loopback for at in places]
    assert found == [True, True, True, False, False]


@pytest.fixture
def made(tmp_path):
    path = tmp_path / "page.pem"
    page_sockets.make_certificate(path, ["192.0.2.7", "lab.example", "2001:db8::1"])
    return path


def test_a_made_certificate_is_valid_for_its_names_and_its_owners_alone(made):
    page_sockets.check_certificate(made)
    assert stat.S_IMODE(made.stat().st_mode) == 0o600
    read = x509.load_pem_x509_certificate(made.read_bytes())
    names = read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["lab.example"]
    addresses = [ip_address("192.0.2.7"), ip_address("2001:db8::1")]
    assert names.get_values_for_type(x509.IPAddress) == addresses
    assert isinstance(read.public_key().curve, ec.SECP256R1)
    shown = ssl.PEM_cert_to_DER_cert(made.read_text().partition("-----BEGIN PRIVATE")[0])
    digest = hashes.Hash(hashes.SHA256())
    digest.update(shown)
    assert page_sockets.fingerprint(made).replace(":", "") == digest.finalize().hex().upper()
    with pytest.raises(FileExistsError):
        page_sockets.make_certificate(made, ["localhost"])


def test_what_is_no_certificate_with_its_key_is_refused(made, tmp_path):
    def parts(path):
        """The PEM texts of certificate and key."""
        text = path.read_text()
        begin = text.index("-----BEGIN PRIVATE")
        return text[:begin], text[begin:]

    page_sockets.make_certificate(tmp_path / "other.pem", ["localhost"])
    (certificate, key), (_, other) = parts(made), parts(tmp_path / "other.pem")
    locked = key.replace("PRIVATE KEY", "ENCRYPTED PRIVATE KEY")
    wrong = tmp_path / "wrong.pem"
    for text, says in (
        ("no PEM at all", "no certificate in PEM form"),
        (key, "no certificate in PEM form"),
        (certificate, "no private key"),
        (certificate + other, "does not belong"),
        (certificate + locked, "a key with a password"),
    ):
        wrong.write_text(text)
        with pytest.raises(ConfigError, match=f"--page-cert .*wrong.pem.*{says}"):
            page_sockets.check_certificate(wrong)


@pytest.mark.parametrize(("days", "says"), [(400, "expired on"), (-9, "only from"), (300, None)])
def test_a_certificate_out_of_its_time_is_refused(made, monkeypatch, days, says):
    class Clock(datetime):
        @classmethod
        def now(cls, zone):
            return datetime.now(zone) + timedelta(days=days)

    monkeypatch.setattr(page_sockets, "datetime", Clock)
    if says is None:
        page_sockets.check_certificate(made)
        return
    with pytest.raises(ConfigError, match=says):
        page_sockets.check_certificate(made)
