"""The folder of an inbox on a disk: read, renamed, answered."""

import json
import tarfile

import pytest

from kontur_av.errors import ConfigError
from pipelines.upkeep.desk import InboxFolder
from telepresence.upkeep.inbox import REST_NS


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
        self.box.tell("v1", "power on", {"v1": "new"})
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
