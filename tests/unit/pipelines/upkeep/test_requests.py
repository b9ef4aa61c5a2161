"""Folders on a disk: an inbox, versions and copies with whatever a program writes into them."""

import json
import os
import socket
import tarfile
from unittest.mock import MagicMock

import pytest

from kontur_av.errors import ConfigError
from pipelines.upkeep.requests import DiskStore, InboxFolder, Program, keeping, kept
from telepresence.link.protection.identity import MachineKey
from telepresence.upkeep.app_loader import BootDevice, Copy, copy_to_backup, note_worked
from telepresence.upkeep.file_store import StoredFile, read_folder
from telepresence.upkeep.inbox import REST_NS
from telepresence.upkeep.manifest import (
    MANIFEST,
    SFV,
    executables,
    fault_of,
    signed_manifest,
    write_copy,
)
from telepresence.upkeep.version_stack import VersionDirectory


class Keeper:
    """Takes what comes, but for what `fault` says."""

    def __init__(self, folder):
        self.folder, self.taken, self.fault, self.now_ns = folder, [], None, 0
        self.box = self.again()

    def again(self):
        return InboxFolder(self.folder, {"start"}, add=self.add, order=self.order)

    def add(self, name, files):
        if self.fault is not None:
            raise self.fault
        self.taken.append((name, sorted(files)))
        return "added"

    def order(self, text):
        self.taken.append(text)
        return "done"

    def work(self):
        """Long enough for all that lies there."""
        for _ in range(5):
            self.now_ns += REST_NS
            self.box.work(busy=False, now_ns=self.now_ns)
        self.box.publish("v1", "power on", {"v1": "new"})
        told = json.loads((self.folder / "upkeep.json").read_text())
        return {one["file"]: (one["taken"], one["text"]) for one in told["answers"]}


@pytest.fixture
def keeper(tmp_path):
    return Keeper(tmp_path / "far" / "inbox")


def put(keeper, name):
    source = keeper.folder.parent / "run"
    source.write_text("#!/bin/sh\n")
    with tarfile.open(keeper.folder / name, "w") as archive:
        archive.add(source, "run")


def test_what_comes_is_taken_and_gets_another_name(keeper):
    put(keeper, "v2.tar")
    (keeper.folder / "x.order").write_text("start v2\n")
    (keeper.folder / "y.order").write_text("rm -rf\n")
    (keeper.folder / "notes.txt").write_text("nothing for it")
    answers = keeper.work()
    assert sorted(keeper.taken, key=str) == [("v2", ["run"]), "start v2"]
    assert answers["v2.tar"] == (True, "added")
    assert answers["x.order"] == (True, "done")
    assert answers["y.order"][0] is False
    left = {"notes.txt", "upkeep.json", "v2.tar.taken", "x.order.taken", "y.order.refused"}
    assert {path.name for path in keeper.folder.iterdir()} == left
    keeper.box = keeper.again()
    assert keeper.work() == answers


@pytest.mark.parametrize("fault", [ConfigError("not trusted"), OSError(28, "No space left")])
def test_what_the_keeper_refuses_is_told_with_the_reason(keeper, fault):
    keeper.fault = fault
    put(keeper, "v2.tar")
    ((taken, text),) = keeper.work().values()
    assert not taken and (fault.strerror if isinstance(fault, OSError) else str(fault)) in text
    assert (keeper.folder / "v2.tar.refused").exists()


def test_a_link_out_of_the_folder_is_not_followed(keeper):
    put(keeper, "v2.tar")
    elsewhere = keeper.folder.parent / "v2.tar"
    (keeper.folder / "v2.tar").rename(elsewhere)
    (keeper.folder / "v2.tar").symlink_to(elsewhere)
    assert keeper.work() == {}
    assert keeper.taken == []


FILES = {"run": StoredFile(b"#!/bin/sh\n", executable=True), "lib/tool": StoredFile(b"1", True)}


def bound(path):
    os.chdir(path.parent)
    socket.socket(socket.AF_UNIX).bind(path.name)


#: By name: what makes an entry that no copy can hold.
ODD = {
    "inside": lambda path: path.symlink_to("run"),
    "outside": lambda path: path.symlink_to("/etc"),
    "dangling": lambda path: path.symlink_to("nowhere"),
    "itself": lambda path: path.symlink_to("itself"),
    "log": lambda path: (path / "empty").mkdir(parents=True),
    "pipe": os.mkfifo,
    "socket": bound,
    "two\nlines": lambda path: path.write_text(""),
    "back\\slash": lambda path: path.write_text(""),
    os.fsdecode(b"latin\xe9"): lambda path: path.write_text(""),
}


@pytest.mark.parametrize("name", ODD, ids=range(len(ODD)))
def test_what_no_copy_can_hold_is_refused_when_a_folder_is_taken_over(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    write_copy(DiskStore(tmp_path), "v", FILES)
    assert {**read_folder(DiskStore(tmp_path), "v"), SFV: None} == {**FILES, SFV: None}
    ODD[name](tmp_path / "v" / name)
    with pytest.raises(ConfigError) as refused:
        read_folder(DiskStore(tmp_path), "v")
    assert repr(name)[1:-1] in str(refused.value)


def test_whatever_a_program_writes_into_its_folder_a_version_and_a_copy_stay_whole(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    store, key = DiskStore(tmp_path), MachineKey.from_seed(bytes(32))
    versions = VersionDirectory(store, {key.identity})
    signed = {**FILES, MANIFEST: StoredFile(signed_manifest("v", FILES, key))}
    versions.add("v", signed)
    for copy in (Copy.SD_1, Copy.SD_2):
        write_copy(store, copy.value, FILES)
    note_worked(store, Copy.SD_1)
    assert executables(store.read("sd/1/files.sfv")) == {"run", "lib/tool"}
    for folder in ("v", "sd/1"):
        for name, make in {**ODD, "__pycache__": lambda path: bound(path / "x")}.items():
            (tmp_path / folder / "lib" / name).parent.mkdir(exist_ok=True)
            if name == "__pycache__":
                (tmp_path / folder / "lib" / name).mkdir()
            make(tmp_path / folder / "lib" / name)
    versions.check("v")
    assert fault_of(store, "sd/1") is None
    copy_to_backup(store, BootDevice.SD)
    assert set(store.files("sd/2")) == {*FILES, SFV}
    # The new version of this name has none of it, and the removed one leaves nothing.
    versions.add("v", signed)
    assert store.files("v") == sorted(signed)
    (tmp_path / "v/lib/tool").unlink()
    (tmp_path / "v/lib/tool").symlink_to("/etc/hostname")
    with pytest.raises(ValueError, match="cannot be read"):
        versions.check("v")
    versions.forget("v")
    assert not (tmp_path / "v").exists()


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, bound, lambda path: path.symlink_to(path)])
def test_whatever_a_program_makes_of_its_status_the_keeper_goes_on(tmp_path, monkeypatch, make):
    monkeypatch.chdir(tmp_path)
    program = Program(tmp_path / ".status", ())
    make(tmp_path / ".status")
    assert not program.news()
    monkeypatch.setattr("subprocess.Popen", MagicMock(side_effect=OSError))
    assert not program.start(tmp_path)


def test_a_keeper_that_starts_waits_for_a_command_that_looks(tmp_path, monkeypatch):
    looks = kept(tmp_path)
    assert looks.__enter__()
    monkeypatch.setattr("time.sleep", lambda _: looks.__exit__(None, None, None))
    with keeping(tmp_path), kept(tmp_path) as free:
        assert not free
