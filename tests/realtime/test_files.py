"""Files beside a live session: both ways, across a loss of signal, and past a killed process."""

import os
import signal
from random import Random

from file_transfer import Transfer
from running_session import RunningSession, assert_sound, eventually

from kontur_av.clock import NS_PER_S

DOWN = Random(1).randbytes(90_000)
UP = Random(2).randbytes(1_500)


def test_files_go_both_ways_across_a_loss_of_signal_beside_the_media(tmp_path):
    directory = tmp_path / "files"
    for end, name, octets in (("space", "down.bin", DOWN), ("ground", "up.bin", UP)):
        (directory / end).mkdir(parents=True)
        (directory / end / name).write_bytes(octets)
    options = ("--files", str(directory), "--files-rate", "8,300", "--trainer")
    with RunningSession("spacejustin", *options, directory=tmp_path) as session:
        pids = session.pids()
        session.wait_for_flow()
        down = Transfer(session, "put", "down.bin", "kept/down.bin", "--from", "space")
        up = Transfer(session, "put", "up.bin")
        down.until("running")
        assert session.ask("trainer", "los", "2").returncode == 0
        down.until("suspended")
        assert (down.end(), up.end()) == (0, 0), (down.said(), up.said())
        assert (directory / "ground" / "kept" / "down.bin").read_bytes() == DOWN
        assert (directory / "space" / "up.bin").read_bytes() == UP

        # Ctrl-C gives a transfer up, and leaves nothing at the other end.
        cut = Transfer(session, "put", "down.bin", "cut.bin", "--from", "space")
        cut.until("running")
        listed = session.ask("file", "status", "--from", "space").stdout
        assert listed.splitlines()[1].split()[1:3] == ["put", "running"]
        cut.interrupt()
        assert cut.end() == 130
        listed = session.ask("file", "status", "--from", "space").stdout
        assert listed == "nothing is under way\n"

        # The receiver is killed: the sender gives it the file again.
        down = Transfer(session, "get", "down.bin", "again.bin")
        down.until("running")
        os.kill(pids["files_ground"], signal.SIGKILL)
        # Who asked it for the file hears nothing more.
        assert down.end() != 0
        again = directory / "ground" / "again.bin"
        eventually(again.exists, "the second way of the file")
        assert again.read_bytes() == DOWN

        listed = session.ask("file", "list", "--from", "space")
        assert [line.split()[-1] for line in listed.stdout.splitlines()] == [
            "again.bin",
            "kept/",
            "up.bin",
        ]
        assert session.ask("file", "rename", "up.bin", "new.bin").returncode == 0
        assert session.ask("file", "remove", "none").returncode == 1
        assert session.ask("file", "get", "../x").returncode == 2
        assert (directory / "space" / "new.bin").read_bytes() == UP
        assert not (directory / "ground" / "cut.bin").exists()
        code, report = session.interrupt()
    assert code == 0
    assert_sound(report)
    for link in report["link"].values():
        drops = link["queue"]["maintenance"]["drops"]
        assert (drops["full"], drops["expired"]) == (0, 0)
        # Media never wait behind a file, so none of theirs is too old.
        assert link["queue"]["voice"]["drops"]["full"] == 0
    counts = report["processes"]["files_space"]["counts"]
    assert counts["file_octets_sent"] >= len(DOWN)
    assert counts["file_suspended_ns"] > NS_PER_S
    assert counts["file_garbage"] == 0
    assert report["processes"]["files_ground"]["restarts"] == 1
