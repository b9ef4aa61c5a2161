"""`kontur-av keys`: one line for each mistake, and a private key that stays private."""

import os
import stat

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.link.key_files import (
    default_key_path,
    make_key,
    pinned_peer,
    read_key,
    trusted_identities,
    trusted_path,
)
from telepresence.link.protection.identity import MachineKey

OTHER = MachineKey.from_seed(bytes(32)).identity
THIRD = MachineKey.from_seed(bytes([1] * 32)).identity


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config" / "kontur-av"


def done(capsys, *words):
    """What a command prints that does as it is told."""
    assert main([str(word) for word in words]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


def refused(capsys, *words):
    """The one line with which a command is refused."""
    assert main([str(word) for word in words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("kontur-av: ") and err.count("\n") == 1
    return err


def test_from_a_new_key_to_a_trusted_peer(home, capsys):
    before = os.umask(0)
    try:
        made = done(capsys, "keys", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((home / "key.pem").stat().st_mode) == 0o600
    assert stat.S_IMODE(home.stat().st_mode) == 0o700
    shown = done(capsys, "keys", "show")
    assert shown.count("\n") == 1 and made.endswith(shown)
    assert done(capsys, "keys", "list") == ""
    # As it was heard: in small letters, in groups.
    done(capsys, "keys", "trust", *str(OTHER).lower().split("-"))
    assert "already" in done(capsys, "keys", "trust", OTHER)
    done(capsys, "keys", "trust", THIRD)
    assert done(capsys, "keys", "list") == f"{OTHER}\n{THIRD}\n"
    assert stat.S_IMODE((home / "key.pem.trusted").stat().st_mode) == 0o600
    done(capsys, "keys", "forget", THIRD)
    assert done(capsys, "keys", "list") == f"{OTHER}\n"
    assert sorted(path.name for path in home.iterdir()) == ["key.pem", "key.pem.trusted"]


def test_each_key_file_has_its_own_trusted_identities(home, tmp_path, capsys):
    for name in ("ground.pem", "space.pem"):
        done(capsys, "keys", "new", "--key", tmp_path / name)
    space = read_key(tmp_path / "space.pem").identity
    done(capsys, "keys", "trust", space, "--key", tmp_path / "ground.pem")
    assert pinned_peer(tmp_path / "ground.pem", None) == space
    assert trusted_identities(tmp_path / "space.pem") == []
    assert not home.exists()


def test_a_key_is_never_overwritten(home, capsys):
    done(capsys, "keys", "new")
    before = (home / "key.pem").read_bytes()
    assert "exists: a new key is a new identity" in refused(capsys, "keys", "new")
    assert (home / "key.pem").read_bytes() == before


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644])
def test_a_key_that_others_may_read_is_refused(home, capsys, mode):
    done(capsys, "keys", "new")
    (home / "key.pem").chmod(mode)
    assert f"chmod 600 {home / 'key.pem'}" in refused(capsys, "keys", "show")
    assert "chmod 600" in refused(capsys, "keys", "trust", OTHER)


def test_trusted_identities_that_others_may_write_are_refused(home, capsys):
    done(capsys, "keys", "new")
    done(capsys, "keys", "trust", OTHER)
    (home / "key.pem.trusted").chmod(0o620)
    assert "chmod go-w" in refused(capsys, "keys", "list")


def test_what_is_missing_or_wrong_is_said_in_one_line(home, tmp_path, capsys):
    assert "`kontur-av keys new` makes one" in refused(capsys, "keys", "show")
    assert "keys new" in refused(capsys, "keys", "trust", OTHER)
    done(capsys, "keys", "new")
    own = done(capsys, "keys", "show").strip()
    assert "that of the other one" in refused(capsys, "keys", "trust", own)
    assert "mistyped" in refused(capsys, "keys", "trust", str(OTHER)[:-1] + "A")
    assert "is not trusted" in refused(capsys, "keys", "forget", OTHER)
    trusted_path(home / "key.pem").write_text("# a note\n\nnonsense\n")
    assert "key.pem.trusted, line 3: identity 'nonsense'" in refused(capsys, "keys", "list")
    assert "is no file" in refused(capsys, "keys", "show", "--key", tmp_path)
    os.mkfifo(tmp_path / "fifo", 0o600)
    assert "is no file" in refused(capsys, "keys", "show", "--key", tmp_path / "fifo")
    assert "cannot be written" in refused(capsys, "keys", "new", "--key", home / "key.pem" / "x")


def test_a_damaged_key_is_not_quoted(home, capsys):
    done(capsys, "keys", "new")
    secret = (home / "key.pem").read_bytes()
    (home / "key.pem").write_bytes(secret.replace(b"BEGIN PRIVATE", b"BEGIN PIRATE"))
    line = refused(capsys, "keys", "show")
    assert "no private key" in line
    assert secret.splitlines()[1].decode() not in line


def test_a_relative_configuration_directory_is_ignored(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", "here")
    assert default_key_path() == tmp_path / ".config" / "kontur-av" / "key.pem"


def test_a_user_without_a_home_directory_is_told_so(monkeypatch, capsys):
    def unknown(uid):
        raise KeyError(uid)

    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    assert "set HOME" in refused(capsys, "keys", "show")


def test_the_peer_is_the_only_one_that_is_trusted_or_the_one_that_is_named(home, capsys):
    key = home / "key.pem"
    make_key(key)
    with pytest.raises(ConfigError, match="trusts nobody"):
        pinned_peer(key, None)
    done(capsys, "keys", "trust", OTHER)
    assert pinned_peer(key, None) == pinned_peer(key, str(OTHER)) == OTHER
    with pytest.raises(ConfigError, match="is not trusted"):
        pinned_peer(key, str(THIRD))
    done(capsys, "keys", "trust", THIRD)
    with pytest.raises(ConfigError, match="trusts 2 identities"):
        pinned_peer(key, None)
    assert pinned_peer(key, str(THIRD)) == THIRD
