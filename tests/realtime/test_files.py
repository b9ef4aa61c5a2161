"""Files beside a live session: both ways, across a loss of signal, and past a killed process."""

import os
import signal
import subprocess
from random import Random

from running_session import COMMAND, PATIENCE_S, RunningSession, assert_sound, eventually

from kontur_av.clock import NS_PER_S

DOWN = Random(1).randbytes(150_000)
UP = Random(2).randbytes(1_500)


class Transfer:
    """`kontur-av file` in another terminal."""

    def __init__(self, session, *words):
        self._said = (session.directory / f"{words[0]}-{words[1].replace('/', '-')}").open("w+")
        self._process = subprocess.Popen(
            [*COMMAND, "file", *words],
            stdout=self._said,
            stderr=self._said,
            env=session.environment,
        )

    def said(self):
        self._said.seek(0)
        return self._said.read()

    def until(self, text):
        eventually(lambda: text in self.said(), f"{text} of {self.said()}")

    def end(self):
        return self._process.wait(PATIENCE_S)


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
