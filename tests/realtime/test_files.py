"""Files beside a live session: both ways, across a loss of signal, and past a killed process."""

import os
import signal
from random import Random

import pytest
from file_transfer import Transfer
from running_session import BOARD, RunningSession, eventually

#: Some seconds, in which another command can begin.
DOWN = Random(1).randbytes(200_000)
UP = Random(2).randbytes(1_500)
#: It takes more than a minute, so that a slow machine can still cancel it.
LONG = bytes(3_000_000)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    top = tmp_path_factory.mktemp("files")
    for path, octets in (("space/down.bin", DOWN), ("space/long.bin", LONG), ("ground/up.bin", UP)):
        (top / "files" / path).parent.mkdir(parents=True, exist_ok=True)
        (top / "files" / path).write_bytes(octets)
    options = ("--files", str(top / "files"), "--files-rate", "8,300", "--trainer")
    with RunningSession(BOARD, *options, directory=top) as one:
        one.wait_for_flow()
        yield one


@pytest.fixture
def ends(session):
    return session.directory / "files" / "ground", session.directory / "files" / "space"


def test_files_go_both_ways_across_a_loss_of_signal(session, ends):
    ground, space = ends
    down = Transfer(session, "put", "down.bin", "kept/down.bin", "--from", "space")
    up = Transfer(session, "put", "up.bin")
    down.until("running")

    def suspended():
        return session.ask("trainer", "los", "2").returncode == 0 and "suspended" in down.said()

    eventually(suspended, "the loss of signal", pause_s=0.5)
    assert (down.end(), up.end()) == (0, 0), (down.said(), up.said())
    assert (ground / "kept" / "down.bin").read_bytes() == DOWN
    assert (space / "up.bin").read_bytes() == UP
    listing = session.ask("file", "list", "log").stdout
    name = f"log/{listing.split()[-1]}"
    assert session.ask("file", "get", name).returncode == 0, listing
    assert " begins: " in (ground / name).read_text()


def test_a_transfer_is_cancelled_by_ctrl_c_or_by_its_number(session, ends):
    for number, ended in enumerate((130, 1)):
        cut = Transfer(session, "put", "long.bin", "cut.bin", "--from", "space")
        cut.until("running")

        def running():
            (line,) = session.ask("file", "status", "--from", "space").stdout.splitlines()[1:]
            return line if line.split()[1:3] == ["put", "running"] else ""

        line = eventually(running, "its line")
        if number == 0:
            cut.interrupt()
        else:
            asked = session.ask("file", "cancel", line.split()[0], "--from", "space")
            assert asked.returncode == 0, asked.stderr
        assert cut.end() == ended, cut.said()
        assert session.ask("file", "status", "--from", "space").stdout == "nothing is under way\n"
        # Nothing is left at the other end.
        assert not (ends[0] / "cut.bin").exists()
    assert session.ask("file", "cancel", "99").returncode == 2


def test_the_other_ends_directory_is_listed_renamed_and_removed_in(session, ends):
    space = ends[1]
    (space / "old.bin").write_bytes(UP)
    listed = session.ask("file", "list")
    assert {"down.bin", "old.bin"} <= {line.split()[-1] for line in listed.stdout.splitlines()}
    assert session.ask("file", "rename", "old.bin", "new.bin").returncode == 0
    assert (space / "new.bin").read_bytes() == UP
    assert session.ask("file", "remove", "new.bin").returncode == 0
    assert not (space / "new.bin").exists() and not (space / "old.bin").exists()
    assert session.ask("file", "remove", "none").returncode == 1
    assert session.ask("file", "get", "../x").returncode == 2


def test_a_killed_receiver_gets_the_file_again_and_media_waited_for_no_file(session, ends):
    pid = session.pids()["files_ground"]
    down = Transfer(session, "get", "down.bin", "again.bin")
    down.until("running")
    os.kill(pid, signal.SIGKILL)
    # Who asked it for the file hears nothing more.
    assert down.end() != 0
    again = ends[0] / "again.bin"
    eventually(again.exists, "the second way of the file")
    assert again.read_bytes() == DOWN
    session.wait_for_flow()
    report = session.finish(sound=True)
    for link in report["link"].values():
        drops = link["queue"]["maintenance"]["drops"]
        assert (drops["full"], drops["expired"]) == (0, 0)
        # Media never wait behind a file, so none of theirs is too old.
        assert link["queue"]["voice"]["drops"]["full"] == 0
    counts = report["processes"]["files_space"]["counts"]
    assert counts["file_octets_sent"] >= len(DOWN)
    assert counts["file_garbage"] == 0
    assert report["processes"]["files_ground"]["restarts"] == 1
