"""`kontur-av keys`: from a new key to a trusted peer, and a private key that stays private."""

import os
import stat

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.link import key_files
from telepresence.link.protection.identity import MachineKey

OTHER, THIRD = (MachineKey.from_seed(bytes([n] * 32)).identity for n in (0, 1))


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config" / "kontur-av"


@pytest.fixture
def done(capsys):
    """done(*words): what a command prints that does as it is told."""

    def run(*words):
        assert main(["keys", *(str(word) for word in words)]) == 0
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return run


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_from_a_new_key_to_a_trusted_peer_and_a_damaged_key_is_not_quoted(home, done, capsys):
    before = os.umask(0)
    try:
        made = done("new")
    finally:
        os.umask(before)
    assert (mode_of(home), mode_of(home / "key.pem")) == (0o700, 0o600)
    shown = done("show")
    assert shown.count("\n") == 1 and made.endswith(shown)
    assert done("list") == ""
    # As it was heard: in small letters, in groups.
    done("trust", *str(OTHER).lower().split("-"))
    assert "already" in done("trust", OTHER)
    done("trust", THIRD)
    assert done("list") == f"{OTHER}\n{THIRD}\n"
    assert mode_of(home / "key.pem.trusted") == 0o600
    done("forget", THIRD)
    assert done("list") == f"{OTHER}\n"
    assert sorted(path.name for path in home.iterdir()) == ["key.pem", "key.pem.trusted"]
    secret = (home / "key.pem").read_bytes()
    (home / "key.pem").write_bytes(secret.replace(b"BEGIN PRIVATE", b"BEGIN PIRATE"))
    assert main(["keys", "show"]) == 2
    assert secret.splitlines()[1].decode() not in capsys.readouterr().err


def test_keys_lie_in_an_absolute_configuration_directory_or_in_the_home(
    monkeypatch, tmp_path, capsys
):
    def unknown(uid):
        raise KeyError(uid)

    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", "here")
    assert key_files.default_key_path() == tmp_path / ".config" / "kontur-av" / "key.pem"
    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setattr("pwd.getpwuid", unknown)
    assert main(["keys", "show"]) == 2
    assert "set HOME" in capsys.readouterr().err


def test_the_peer_is_the_only_one_that_is_trusted_or_the_one_that_is_named(home, done):
    key = home / "key.pem"
    key_files.make_key(key)
    with pytest.raises(ConfigError, match="trusts nobody"):
        key_files.pinned_peer(key, None)
    done("trust", OTHER)
    assert key_files.pinned_peer(key, None) == key_files.pinned_peer(key, str(OTHER)) == OTHER
    with pytest.raises(ConfigError, match="is not trusted"):
        key_files.pinned_peer(key, str(THIRD))
    done("trust", THIRD)
    with pytest.raises(ConfigError, match="trusts 2 identities"):
        key_files.pinned_peer(key, None)
    assert key_files.pinned_peer(key, str(THIRD)) == THIRD
