"""Small programs for the keepers of `kontur-av versions` and `apploader`, and their commands."""

import signal
import subprocess
from contextlib import contextmanager, redirect_stdout
from io import StringIO

from common import TIMEOUT_S
from running_session import COMMAND

from pipelines.cli import main

#: A program that tells what it is given, ten times a second, and where it runs.
PROGRAM = """#!/bin/sh
echo {name} >> "$TRACE"
echo $$ > "$TRACE.pid"
trap 'exit 0' TERM
while :; do
    echo '{status}' > "$KONTUR_AV_STATUS.new" && mv "$KONTUR_AV_STATUS.new" "$KONTUR_AV_STATUS"
    sleep 0.1
done
"""
WORKS = '{"contact": true, "passed": true, "stuck": false}'


def make(folder, name, status=WORKS, text=PROGRAM):
    place = folder / name
    place.mkdir(parents=True)
    (place / "run").write_text(text.format(name=name, status=status))
    (place / "run").chmod(0o755)
    return place


def command(*words):
    """Run a command here, which takes a tenth of the time of a new process; what it printed."""
    with redirect_stdout(StringIO()) as said:
        assert main([*map(str, words)]) == 0
    return said.getvalue()


@contextmanager
def running(*words, stdout=subprocess.DEVNULL, stderr=None):
    command = [*COMMAND, *map(str, words)]
    process = subprocess.Popen(command, stdout=stdout, stderr=stderr)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(TIMEOUT_S)
