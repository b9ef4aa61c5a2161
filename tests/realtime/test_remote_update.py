"""Updates that come as files across a live link: tried, and undone where they are broken."""

import json
import subprocess
from random import Random

import pytest
from file_transfer import Transfer
from running_session import BOARD, RunningSession, eventually
from upkeep_programs import PROGRAM, WORKS, make, running

from pipelines.link.key_files import make_key, read_key
from pipelines.upkeep.loader_keeper import LoaderKeeper
from pipelines.upkeep.requests import DiskStore
from pipelines.upkeep.version_keeper import VersionKeeper
from telepresence.upkeep.app_loader import Copy, note_worked
from telepresence.upkeep.file_store import read_folder, replace_file
from telepresence.upkeep.manifest import MANIFEST, SFV, sfv_text, signed_manifest

CRASHES = '#!/bin/sh\necho {name} >> "$TRACE"\nexit 1\n'
#: It tells that an experiment runs while there is a file of its trace's name and .busy.
BUSY = PROGRAM.replace("echo '{status}'", 'cat "$TRACE.busy"')


def sign(folder, key):
    files = read_folder(DiskStore(folder), "")
    replace_file(DiskStore(folder), MANIFEST, signed_manifest(folder.name, files, read_key(key)))


def pack(folder, place):
    """What tar makes of a folder, and gzip of that."""
    place.mkdir(parents=True, exist_ok=True)
    path = place / f"{folder.name}.tar.gz"
    subprocess.run(["tar", "-C", folder, "-czf", path, "."], check=True)
    return path


@pytest.fixture(scope="module")
def ends(tmp_path_factory):
    """A session with files and both keepers, which watch the folders that files come into."""
    top = tmp_path_factory.mktemp("update")
    trace, key, unknown = top / "trace", top / "key.pem", top / "unknown sender.pem"
    trace.touch()
    versions, storages, space = top / "versions", top / "storages", top / "ends" / "space"
    identity = make_key(key).identity
    make_key(unknown)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRACE", str(trace))
        keeper = VersionKeeper(versions, {identity}, print)
        for name in ("elementary", "v1"):
            folder = make(top, name, text=BUSY)
            sign(folder, key)
            keeper.add(name, folder)
        keeper.order("start", "v1")
        (top / "trace.busy").write_text(WORKS.replace("}", ', "busy": true}'))
        for copy in (Copy.SD_1, Copy.SD_2, Copy.FLASH):
            LoaderKeeper(storages, print).fill(copy, make(top / copy.value, "first"))
        options = ("--files", str(top / "ends"), "--files-rate", "15,200", "--trainer")
        with (
            RunningSession(BOARD, *options, directory=top) as session,
            running("versions", "run", versions, "--key", key, "--inbox", space / "link"),
            running("apploader", "run", storages, "--inbox", space / "joystick"),
        ):
            session.wait_for_flow()
            yield Ends(session, top)
            session.finish(sound=True)


class Ends:
    """What goes up to the keepers in space, and what they tell."""

    def __init__(self, session, top):
        self.session, self.top, self.key = session, top, top / "key.pem"
        self.trace, self.storages = top / "trace", top / "storages"
        self.ground, self.space = top / "ends" / "ground", top / "ends" / "space"

    def told(self, name):
        try:
            return json.loads((self.space / name / "upkeep.json").read_text())
        except OSError:
            return {"answers": [], "waiting": [], "runs": "", "states": {}}

    def answers(self, name):
        return {one["file"].split(".")[0]: one["text"] for one in self.told(name)["answers"]}

    def put(self, name):
        return Transfer(self.session, "put", name)

    def pack_version(self, name, text, *, key=None, ballast=b""):
        folder = make(self.top, name, text=text)
        (folder / "ballast").write_bytes(ballast)
        sign(folder, key or self.key)
        pack(folder, self.ground / "link")

    def pack_copy(self, name, text):
        folder = make(self.top, name, text=text)
        replace_file(DiskStore(folder), SFV, sfv_text(read_folder(DiskStore(folder), "")))
        pack(folder, self.ground / "joystick")

    def fetched(self, name):
        """What a keeper tells, as it came down."""
        assert Transfer(self.session, "get", f"{name}/upkeep.json").end() == 0
        return json.loads((self.ground / name / "upkeep.json").read_text())


def test_a_version_comes_across_a_loss_of_signal_and_starts_after_the_experiment(ends):
    # It takes 15 s, so that a slow machine can begin the loss of signal before its end.
    ends.pack_version("v2", PROGRAM, ballast=Random(1).randbytes(28_000))
    ends.pack_version("foreign", PROGRAM, key=ends.top / "unknown sender.pem")
    sent = [ends.put("link/v2.tar.gz")]
    sent[0].until("running")
    assert ends.session.ask("trainer", "los", "2").returncode == 0
    sent.append(ends.put("link/foreign.tar.gz"))
    sent[0].until("suspended")
    assert [one.end() for one in sent] == [0] * 2, [one.said() for one in sent]
    # The experiment first: v1 goes on.
    eventually(lambda: {*ends.told("link")["waiting"]} >= {"v2.tar.gz", "foreign.tar.gz"})
    assert "v2" not in ends.trace.read_text() and ends.told("link")["busy"]
    (ends.top / "trace.busy").write_text(WORKS)
    eventually(lambda: ends.told("link")["runs"] == "v2")
    eventually(lambda: {*ends.answers("link")} == {"v2", "foreign"})
    assert "not trusted" in ends.answers("link")["foreign"]
    assert (ends.space / "link" / "foreign.tar.gz.refused").exists()


def test_a_version_that_crashes_is_undone_and_the_ground_is_told_why(ends):
    (ends.top / "trace.busy").write_text(WORKS)
    eventually(lambda: ends.told("link")["runs"])
    before = ends.told("link")["runs"]
    ends.pack_version("v3", CRASHES)
    assert ends.put("link/v3.tar.gz").end() == 0
    eventually(lambda: ends.trace.read_text().count("v3") == 3)
    eventually(lambda: ends.told("link")["runs"] == before)
    link = ends.fetched("link")
    assert link["states"]["v3"] == "defective"
    assert link["why"] == "v3: ended by itself, 3 times"


def test_an_update_of_the_joystick_is_copied_once_it_has_worked_and_a_broken_one_is_undone(ends):
    ends.pack_copy("good", PROGRAM)
    ends.pack_copy("broken", CRASHES)
    (ends.ground / "joystick" / "copy.order").write_text("copy\n")
    assert ends.put("joystick/good.tar.gz").end() == 0
    eventually(lambda: ends.told("joystick")["runs"] == "sd/1" and "good" in ends.trace.read_text())
    # Its minute without a malfunction is over.
    note_worked(DiskStore(ends.storages), Copy.SD_1)
    for name in ("copy.order", "broken.tar.gz"):
        assert ends.put(f"joystick/{name}").end() == 0
    eventually(
        lambda: "broken" in ends.answers("joystick") and ends.told("joystick")["runs"] == "sd/2"
    )
    joystick = ends.fetched("joystick")
    assert joystick["states"] == {"sd/1": "it ended with 1", "sd/2": "valid"}
    assert [one["text"] for one in joystick["answers"]] == [
        *("written to sd/1", "done", "written to sd/1"),
    ]
    # Backup is the update that had worked.
    assert "echo good" in (ends.storages / "sd/2/run").read_text()
    names = ("broken.tar.gz", "copy.order", "good.tar.gz")
    taken = [f"{name}.taken" for name in names]
    assert sorted(path.name for path in (ends.space / "joystick").iterdir()) == [
        *(*taken, "upkeep.json"),
    ]
