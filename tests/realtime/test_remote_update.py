"""Updates that come as files across a live link: tried, and undone where they are broken."""

import json
import subprocess
from random import Random

from file_transfer import Transfer
from running_session import RunningSession, assert_sound
from upkeep_programs import PROGRAM, WORKS, make, running, until

from pipelines.link.key_files import make_key, read_key
from pipelines.upkeep.desk import DiskStore
from pipelines.upkeep.loader_keeper import LoaderKeeper
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


def listed(folder):
    replace_file(DiskStore(folder), SFV, sfv_text(read_folder(DiskStore(folder), "")))


def test_updates_across_the_link_run_or_are_undone_by_themselves(tmp_path, monkeypatch):
    trace, key, stranger = tmp_path / "trace", tmp_path / "key.pem", tmp_path / "stranger.pem"
    trace.touch()
    monkeypatch.setenv("TRACE", str(trace))
    make_key(key)
    make_key(stranger)
    ends, versions, storages = tmp_path / "ends", tmp_path / "versions", tmp_path / "storages"
    keeper = VersionKeeper(versions, {read_key(key).identity}, print)
    busy = tmp_path / "trace.busy"
    busy.write_text(WORKS.replace("}", ', "busy": true}'))
    for name, text in (("elementary", PROGRAM), ("v1", BUSY)):
        folder = make(tmp_path, name, text=text)
        sign(folder, key)
        keeper.add(name, folder)
    keeper.order("start", "v1")
    for copy in (Copy.SD_1, Copy.SD_2, Copy.FLASH):
        LoaderKeeper(storages, print).fill(copy, make(tmp_path / copy.value, "first"))

    ground = ends / "ground"
    for name, text, by in (
        ("v2", PROGRAM, key),
        ("v3", CRASHES, key),
        ("foreign", PROGRAM, stranger),
        ("damaged", PROGRAM, key),
    ):
        folder = make(tmp_path, name, text=text)
        if name == "v2":
            # As large as lasts longer than the loss of signal.
            (folder / "ballast").write_bytes(Random(1).randbytes(8000))
        sign(folder, by)
        if name == "damaged":
            (folder / "run").write_text("#!/bin/sh\n")
        pack(folder, ground / "link")
    for name, text in (("good", PROGRAM), ("broken", CRASHES)):
        folder = make(tmp_path, name, text=text)
        listed(folder)
        pack(folder, ground / "joystick")
    (ground / "joystick" / "copy.order").write_text("copy\n")

    inboxes = {name: ends / "space" / name for name in ("link", "joystick")}

    def told(name):
        try:
            return json.loads((inboxes[name] / "upkeep.json").read_text())
        except OSError:
            return {"answers": [], "waiting": [], "runs": "", "states": {}}

    def answers(name):
        return {one["file"].split(".")[0]: one["text"] for one in told(name)["answers"]}

    options = ("--files", str(ends), "--files-rate", "15,200", "--trainer")
    with (
        RunningSession("taskboard", *options, directory=tmp_path) as session,
        running("versions", "run", versions, "--key", key, "--inbox", inboxes["link"]),
        running("apploader", "run", storages, "--inbox", inboxes["joystick"]),
    ):
        session.wait_for_flow()
        sent = [Transfer(session, "put", "link/v2.tar.gz")]
        sent[0].until("running")
        assert session.ask("trainer", "los", "2").returncode == 0
        names = ("link/foreign", "link/damaged", "joystick/good")
        sent += [Transfer(session, "put", f"{name}.tar.gz") for name in names]
        sent[0].until("suspended")
        assert [one.end() for one in sent] == [0] * 4, [one.said() for one in sent]
        # The experiment first: v1 goes on.
        until(lambda: {*told("link")["waiting"]} >= {"v2.tar.gz", "foreign.tar.gz"})
        until(lambda: told("joystick")["runs"] == "sd/1" and "good" in trace.read_text())
        assert "v2" not in trace.read_text() and told("link")["busy"]
        busy.write_text(WORKS)
        until(lambda: told("link")["runs"] == "v2")
        until(lambda: {*answers("link")} == {"v2", "foreign", "damaged"})
        assert "not trusted" in answers("link")["foreign"]
        assert "file run is damaged" in answers("link")["damaged"]

        # Its minute without a malfunction is over.
        note_worked(DiskStore(storages), Copy.SD_1)
        sent = [Transfer(session, "put", one) for one in ("link/v3.tar.gz", "joystick/copy.order")]
        assert [one.end() for one in sent] == [0, 0]
        assert Transfer(session, "put", "joystick/broken.tar.gz").end() == 0
        until(lambda: trace.read_text().count("v3") == 3 and told("link")["runs"] == "v2")
        until(lambda: "broken" in answers("joystick") and told("joystick")["runs"] == "sd/2")
        fetched = [Transfer(session, "get", f"{name}/upkeep.json") for name in inboxes]
        assert [one.end() for one in fetched] == [0, 0]
        code, report = session.interrupt()
    link, joystick = (
        json.loads((ground / name / "upkeep.json").read_text()) for name in ("link", "joystick")
    )
    assert link["states"] == {"v2": "executable", "v1": "executable", "v3": "defective"}
    assert link["why"] == "v3: ended by itself, 3 times"
    assert joystick["states"] == {"sd/1": "it ended with 1", "sd/2": "valid"}
    assert [one["text"] for one in joystick["answers"]] == [
        "written to sd/1",
        "done",
        "written to sd/1",
    ]
    # Backup is the update that had worked.
    assert "echo good" in (storages / "sd/2/run").read_text()
    assert sorted(path.name for path in inboxes["joystick"].iterdir()) == [
        "broken.tar.gz.taken",
        "copy.order.taken",
        "good.tar.gz.taken",
        "upkeep.json",
    ]
    assert (code, (inboxes["link"] / "foreign.tar.gz.refused").exists()) == (0, True)
    assert_sound(report)
