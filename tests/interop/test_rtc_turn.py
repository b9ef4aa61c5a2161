"""A partner behind a NAT and we behind another, through coturn only; then its address changes."""

import json
import os
import signal
import subprocess
import sys

import pytest
from common import eventually
from programs import needs, running
from two_hosts import GROUND_PUBLIC, OUTSIDE, PORT, TwoHosts

from pipelines.session.page_sockets import make_certificate

pytestmark = pytest.mark.interop

SECRET, TOKEN = "shared-with-coturn", "word-of-the-partner"


@pytest.fixture
def hosts():
    needs("turnserver")
    with TwoHosts() as hosts:
        yield hosts


def test_both_ends_meet_at_the_relay_and_go_on_from_a_new_address(hosts, tmp_path):
    secret, token, certificate = (tmp_path / name for name in ("secret", "token", "cert.pem"))
    secret.write_text(SECRET)
    token.write_text(TOKEN)
    make_certificate(certificate, [GROUND_PUBLIC])
    command = (sys.executable, "-m", "pipelines.cli")
    turn = ("turnserver", "-n", "--no-cli", "--no-tls", "--no-dtls", "--use-auth-secret")
    turn += (f"--static-auth-secret={SECRET}", "--realm=kontur-av", f"--listening-ip={OUTSIDE}")
    turn += (f"--relay-ip={OUTSIDE}", f"--pidfile={tmp_path}/turn.pid", "--log-file=stdout")
    report = tmp_path / "watch.json"
    told, saved = tmp_path / "watch.txt", tmp_path / "watch.mkv"
    with (
        running(tmp_path / "turn.txt", *hosts.prefix("outside"), *turn, end=signal.SIGTERM),
        running(
            tmp_path / "serve.txt",
            *hosts.prefix("ground"),
            *(*command, "rtc", "serve", "--http", f"0.0.0.0:{PORT}", "--cert", certificate),
            *("--token-file", token, "--video", "scene:left", "--ice-relay-only"),
            *("--ice-server", f"turn:{OUTSIDE}", "--turn-secret-file", secret),
            *("--report", tmp_path / "serve.json"),
        ),
    ):
        eventually(lambda: "page" in (tmp_path / "serve.txt").read_text(), "the server")
        sockets = (*hosts.prefix("outside"), "cat", "/proc/net/udp")
        # 3478
        eventually(lambda: b":0D96 " in subprocess.check_output(sockets), "coturn")
        with running(
            told,
            *hosts.prefix("space"),
            *(*command, "watch", "--whep", f"https://{GROUND_PUBLIC}:{PORT}/whep/main"),
            *("--token-file", token, "--ice-relay-only", "--report", report, "--save", saved),
            # The server's certificate is its own; its credentials for TURN come by its answer.
            env={**os.environ, "SSL_CERT_FILE": str(certificate)},
        ):
            eventually(lambda: "connected by relay to relay" in told.read_text(), "the relayed way")
            eventually(lambda: saved.exists() and saved.stat().st_size > 30_000, "pictures")
            hosts.move_space()
            eventually(lambda: "ICE begins anew" in told.read_text(), "the restart of ICE")
            size = saved.stat().st_size
            eventually(lambda: saved.stat().st_size > size + 30_000, "further pictures")
    watched = json.loads(report.read_text())
    assert watched["last"]["route"] == "relay to relay"
    assert watched["pictures"]["decoded"] > 0
    assert watched["connections"] == 1 and watched["ice_restarts"] >= 1
