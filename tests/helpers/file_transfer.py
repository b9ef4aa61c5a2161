"""`kontur-av file` beside a live session."""

import signal
import subprocess

from running_session import COMMAND, TIMEOUT_S, eventually


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

    def interrupt(self):
        """Press Ctrl-C."""
        self._process.send_signal(signal.SIGINT)

    def end(self):
        return self._process.wait(TIMEOUT_S)
