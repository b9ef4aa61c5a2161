"""The address and the key of a controller by UDP."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.haptics.specs import check_robot, open_device
from telepresence.haptics.udp_line import UdpLine, unprotected
from telepresence.haptics.udp_protocol import UdpRole


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("udp:", "write udp:HOST:PORT"),
        ("udp:127.0.0.1:0", "write udp:HOST:PORT"),
        ("udp:127.0.0.1:x", "write udp:HOST:PORT"),
        ("udp:192.0.2.7:9000", "give both ends a key"),
        ("udp:127.0.0.1:9000:no.key", "openssl rand -hex 32 > no.key"),
        ("udp:127.0.0.1:9000:open.key", "chmod 600 open.key"),
        ("udp:127.0.0.1:9000:bad.key", "64 digits"),
    ],
)
def test_a_spec_that_cannot_be_is_one_line_with_its_mend(spec, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, mode, text in (("open", 0o640, "00" * 32), ("bad", 0o600, "00" * 31 + "xy")):
        path = tmp_path / f"{name}.key"
        path.write_text(text)
        path.chmod(mode)
    for opened in (check_robot, open_device):
        with pytest.raises(ConfigError, match=words) as refused:
            opened(spec)
        assert "\n" not in str(refused.value)


def test_a_key_is_read_and_its_absence_is_said(tmp_path):
    path = tmp_path / "arm.key"
    path.write_text("0f" * 32 + "\n")
    path.chmod(0o600)
    UdpLine(f"192.0.2.7:9000:{path}", UdpRole.ROBOT)
    assert unprotected(f"udp:192.0.2.7:9000:{path}") == unprotected("sim") == ""
    assert "no key" in unprotected("udp:127.0.0.1:9000")
