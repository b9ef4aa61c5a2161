"""Foxglove's own client in Node.js, and where it finds a session."""

import base64
import contextlib
import json
import os
import shutil
import subprocess

import pytest
from positions import ROOT
from running_session import TIMEOUT_S, eventually

CLIENT = ROOT / "tests" / "web" / "foxglove_client.mjs"
PACKAGE = ROOT / ".ci" / "web" / "node_modules" / "@foxglove" / "ws-protocol"
needs_client = pytest.mark.skipif(
    not (shutil.which("node") and PACKAGE.is_dir()),
    reason="@foxglove/ws-protocol: npm --prefix .ci/web install",
)


class FoxgloveClient:
    """One client. told: what it has written so far. certificate: one that it trusts."""

    def __init__(self, url, path, *pace, certificate=""):
        self._path, self._read, self._told = path, 0, []
        with path.open("w") as out:
            self.process = subprocess.Popen(
                ["node", CLIENT, url, *pace],
                stdin=subprocess.PIPE,
                stdout=out,
                text=True,
                env={**os.environ, "NODE_EXTRA_CA_CERTS": str(certificate)},
            )

    def told(self):
        with self._path.open("rb") as file:
            file.seek(self._read)
            for line in file:
                if line.endswith(b"\n"):
                    self._read += len(line)
                    self._told.append(json.loads(line))
        return self._told

    def answers(self, key):
        return [one for one in self.told() if key in one]

    def call(self, number, service, **fields):
        """Call a service; its answer, or its failure."""
        call = {"callId": number, "service": service, "fields": fields}
        self.process.stdin.write(json.dumps(call) + "\n")
        self.process.stdin.flush()

        def answered():
            found = [answer for answer in self.answers("callId") if answer["callId"] == number]
            return found[0] if found else None

        return eventually(answered, f"an answer of {service}")

    def services(self):
        """The names of those that it is offered."""
        return eventually(lambda: self.answers("services"), "the services")[0]["services"]

    def messages(self):
        return [
            (answer["topic"], int(answer["log_ns"]), base64.b64decode(answer["data"]))
            for answer in self.answers("topic")
        ]

    def end(self):
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.wait(TIMEOUT_S)


def address(session, who="foxglove"):
    """Where a session is served. who: foxglove, or watch for the address to watch only."""
    (path,) = eventually(lambda: list(session.temporary.glob("*/*/foxglove.json")), "the address")
    return json.loads(path.read_text())[who]
