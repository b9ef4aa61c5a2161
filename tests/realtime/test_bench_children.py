"""The children of a bench end with it, whatever ends the bench."""

import os
import signal
import subprocess
import threading
import time
from types import SimpleNamespace

import pytest

from pipelines.bench import session
from pipelines.bench.course.ends import End
from pipelines.session.command_process import end_all, ended_alike


def test_a_second_interrupt_ends_all_at_once():
    stubborn = ["sh", "-c", "trap '' TERM; echo; exec sleep 60"]
    processes = [subprocess.Popen(stubborn, stdout=subprocess.PIPE) for _ in range(3)]
    for process in processes:
        process.stdout.readline()

    def interrupt(_number, _frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    # It comes while `end_all` waits.
    processes[-1].terminate = lambda: signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        with pytest.raises(KeyboardInterrupt):
            end_all(processes)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert [process.returncode for process in processes] == [-signal.SIGKILL] * 3


def test_a_live_session_ends_with_the_bench_that_is_terminated(tmp_path, monkeypatch):
    program, begun = tmp_path / "session", tmp_path / "begun"
    program.write_text(f"#!/bin/sh\necho $$ > {begun}.tmp\nmv {begun}.tmp {begun}\nexec sleep 40\n")
    program.chmod(0o755)
    monkeypatch.setattr(session, "sys", SimpleNamespace(executable=str(program)))

    def terminate():
        while not begun.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    # If no handler takes the signal the session runs on, and the tests must survive it.
    before = signal.signal(signal.SIGTERM, lambda _number, _frame: None)
    try:
        threading.Thread(target=terminate).start()
        with pytest.raises(KeyboardInterrupt):
            session.live_session("any", seconds=1, seed=1, radio="clean", base_port=27_000)
    finally:
        signal.signal(signal.SIGTERM, before)
    with pytest.raises(ProcessLookupError):
        os.kill(int(begun.read_text()), 0)


@pytest.mark.parametrize("nohup", [False, True])
def test_a_closed_terminal_ends_the_ends_of_a_channel_but_not_under_nohup(nohup):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if nohup else signal.SIG_DFL)
    try:
        with ended_alike():
            end = End("end", 1, lambda link: signal.getsignal(signal.SIGHUP))
            assert end.result(30) is (signal.SIG_IGN if nohup else signal.SIG_DFL)
            end.close()
    finally:
        signal.signal(signal.SIGHUP, before)
