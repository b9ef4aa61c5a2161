"""Real programs from a directory of versions, and from AppLoader's storages."""

import ftplib
import json
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from common import eventually
from running_link import RunningLink, free_base_port, listening
from running_session import tcp_port
from upkeep_programs import COMMAND, command, make, running

from pipelines.link.key_files import make_key
from pipelines.upkeep.requests import DiskStore
from telepresence.link.supervision.message import VERSION
from telepresence.upkeep.app_loader import Copy, note_worked
from telepresence.upkeep.manifest import fault_of

REFUSED = '{"contact": true, "passed": false, "stuck": true}'
#: It has contact, but nothing tells whether data passes.
UNSURE = '{"contact": false, "passed": false, "stuck": false}'
FAILS = "#!/bin/sh\necho {name} >> $TRACE\nexit 1\n"


@pytest.fixture
def trace(tmp_path, monkeypatch):
    """trace(): the names of the programs that have started, in order."""
    path = tmp_path / "trace"
    path.touch()
    monkeypatch.setenv("TRACE", str(path))
    return lambda: path.read_text().split()


class Versions:
    """A directory of signed versions, by the commands."""

    def __init__(self, tmp_path):
        self.key, self.top = tmp_path / "key.pem", tmp_path / "versions"
        make_key(self.key)

    def add(self, folder, *name):
        command("versions", "sign", folder, "--key", self.key, *name)
        command("versions", "add", self.top, folder, "--key", self.key, *name)

    def do(self, action, name):
        command("versions", action, self.top, name)

    def states(self):
        lines = command("versions", "list", self.top).splitlines()
        return {line.split()[0]: " ".join(line.split()[1:]) for line in lines}

    def running(self, *options):
        return running("versions", "run", self.top, "--key", self.key, *options)


@pytest.fixture
def versions(tmp_path):
    return Versions(tmp_path)


def test_versions_that_fail_are_replaced_by_the_last_that_worked(tmp_path, trace, versions):
    versions.add(make(tmp_path, "elementary"))
    versions.add(make(tmp_path, "v1"))
    versions.add(make(tmp_path, "deaf", REFUSED))
    versions.add(make(tmp_path, "broken", text=FAILS))
    with versions.running("--probation", 1):
        eventually(lambda: trace() == ["elementary"])
        versions.do("start", "v1")
        for name in ("deaf", "broken"):
            # Its state is told before it has begun.
            eventually(lambda: versions.states()["v1"] == "executable runs")
            eventually(lambda: trace()[-1] == "v1")
            versions.do("start", name)
            eventually(lambda one=name: versions.states()[one].startswith("defective"))
        eventually(lambda: versions.states()["v1"] == "executable runs" and trace()[-1] == "v1")
    assert trace() == ["elementary", "v1", "deaf", "v1", "broken", "broken", "broken", "v1"]
    # After a restart the one that worked starts again; one that is damaged does not.
    (versions.top / "v1" / "run").write_text("#!/bin/sh\n")
    with versions.running():
        eventually(lambda: trace()[-1] == "elementary")
    assert versions.states()["v1"] == "defective set aside"


def test_a_version_in_python_stays_whole_with_the_cache_it_was_signed_with_and_its_own_files(
    tmp_path, trace, versions, monkeypatch
):
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    versions.add(make(tmp_path, "elementary"))
    start = "#!/bin/sh\nmkdir log; mkfifo log/pipe\nexec {python} main.py\n"
    place = make(tmp_path, "py", text=start.format(python=sys.executable))
    (place / "main.py").write_text("import helper")
    (place / "helper.py").write_text("import os; print('py', file=open(os.environ['TRACE'], 'a'))")
    subprocess.run([sys.executable, "-c", "import helper"], cwd=place, check=True)
    assert list((place / "__pycache__").iterdir())
    versions.add(place)
    versions.do("start", "py")
    with versions.running():
        eventually(lambda: trace()[-1:] == ["elementary"])
    # Each time it ended by itself, and no file was found damaged.
    assert trace() == ["py"] * 4 + ["elementary"]


def test_a_person_confirms_the_version_that_runs_and_removes_another(tmp_path, trace, versions):
    versions.add(make(tmp_path, "first"), "--name", "elementary")
    versions.add(make(tmp_path, "v1", UNSURE))
    versions.add(make(tmp_path, "v2", UNSURE))
    with versions.running():
        # An order while it starts would be done without it, and keep it out.
        eventually(lambda: trace() == ["first"])
        versions.do("start", "v1")
        eventually(lambda: trace()[-1] == "v1")
        eventually(lambda: versions.states()["v1"] == "new runs")
        versions.do("confirm", "v1")
        eventually(lambda: versions.states()["v1"] == "executable runs")
        versions.do("remove", "v2")
        eventually(lambda: "v2" not in versions.states())
        assert not (versions.top / "v2" / "run").exists()
    # Without a keeper that runs, too; what must stay is refused.
    for action, name, said in (
        ("confirm", "elementary", "does not run: v1 does"),
        ("remove", "v1", "version v1 stays"),
        ("remove", "v2", "there is no version v2"),
    ):
        words = [*COMMAND, "versions", action, versions.top, name]
        done = subprocess.run(words, capture_output=True, text=True)
        assert done.returncode == 2 and said in done.stderr, (action, name)
    versions.do("start", "elementary")
    versions.do("remove", "v1")
    assert {*versions.states()} == {"elementary"}


def test_a_program_ends_with_a_killed_keeper_and_the_next_keeper_starts_it(
    tmp_path, trace, versions
):
    versions.add(make(tmp_path, "elementary"))
    with versions.running() as keeper:
        eventually(lambda: trace() == ["elementary"] and (versions.top / ".status").exists())
        program = Path("/proc") / (tmp_path / "trace.pid").read_text().strip()
        keeper.kill()
        eventually(lambda: not program.exists())
    with versions.running():
        eventually(lambda: trace() == ["elementary", "elementary"])


#: A gateway whose supervision says that it has another version of the link.
GATEWAY = """#!/bin/sh
echo {{name}} >> "$TRACE"
exec {python} -c '
from telepresence.link.supervision.message import Configuration
Configuration.__init__.__kwdefaults__["version"] = {{status}}
from pipelines.cli import main
raise SystemExit(main(["link", "-q", "--setup", "spacejustin", "--insecure", *{options}]))'
"""


def test_a_gateway_that_the_peer_refuses_is_replaced_and_data_passes_again(
    tmp_path, trace, versions
):
    listen = f"127.0.0.1:{free_base_port()}"
    words = ("--setup", "spacejustin", "--end", "ground", "--insecure", "--listen", listen)
    with RunningLink(*words, directory=tmp_path) as ground:
        base = free_base_port()
        options = json.dumps(["--end", "space", "--peer", listen, "--base-port", str(base)])
        program = GATEWAY.format(python=sys.executable, options=options)
        for name, version in (("elementary", VERSION), ("v1", VERSION), ("v2", VERSION + 1)):
            versions.add(make(tmp_path, name, version, program))
        versions.do("start", "v1")
        entries = [
            ground.topology.entry_port("uplink_maintenance"),
            base + ground.topology.entry_port("downlink_maintenance") - ground.base_port,
        ]

        def is_in(state, name):
            with listening(0) as anyone:
                for port in entries:
                    anyone.sendto(b"both ways", ("127.0.0.1", port))
            return versions.states()[name] == state

        with versions.running("--probation", 6):
            eventually(lambda: is_in("executable runs", "v1"))
            versions.do("start", "v2")
            eventually(lambda: is_in("defective", "v2"))
            eventually(lambda: is_in("executable runs", "v1"))
            eventually(lambda: trace() == ["v1", "v2", "v1"])


def test_a_broken_update_of_the_joystick_falls_back_and_a_good_one_is_copied(tmp_path, trace):
    top = tmp_path / "storages"
    first = make(tmp_path, "first")
    for copy in ("sd/1", "sd/2", "flash"):
        command("apploader", "fill", top, copy, first)
    command("apploader", "update", top, make(tmp_path, "broken", text=FAILS))

    def told():
        return json.loads((top / "housekeeping.json").read_text())

    with running("apploader", "run", top) as loader:
        eventually(lambda: trace() == ["broken", "first"])
        eventually(lambda: told()["copy"] == "sd/2" and told()["step"] == "running")
        eventually(lambda: told()["flash"]["files_checked"] >= 1)
        assert list(told()["erroneous"]) == ["sd/1"]
        assert told()["flash"]["sound"]
        command("apploader", "shutdown", top)
        assert loader.wait(90) == 0
    assert "desired mode  backup" in command("apploader", "list", top)
    command("apploader", "update", top, make(tmp_path, "good"))
    # As after its first minute without a malfunction.
    note_worked(DiskStore(top), Copy.SD_1)
    command("apploader", "copy", top)
    assert "echo good" in (top / "sd/2/run").read_text()


@pytest.fixture
def ftp(tmp_path):
    """The URL of a server with two copies, whose programs are called ftp1 and ftp2."""
    pytest.importorskip("pyftpdlib", reason="pyftpdlib: pip install 'kontur-av[upkeep]'")
    top = tmp_path / "server"
    for copy in ("ftp/1", "ftp/2"):
        command("apploader", "fill", top, copy, make(tmp_path, copy.replace("/", "")))
    address = f"127.0.0.1:{tcp_port()}"
    words = ("apploader", "serve", top, "--storage", "ftp", "--listen", address)
    said = tmp_path / "said.txt"
    with (
        said.open("w") as log,
        running(*words, stdout=subprocess.PIPE, stderr=log) as server,
    ):
        yield server.stdout.readline().decode().split()[-1]
    # What its library says of each look at its sockets is left out.
    assert "starting" not in said.read_text()


def test_ftp_serves_both_copies_and_an_upload_needs_its_list_of_checksums(tmp_path, ftp):
    url, copies = urlsplit(ftp), tmp_path / "server" / "ftp"
    with ftplib.FTP() as client:
        client.connect(url.hostname, url.port, 90)
        client.login(url.username, url.password)
        assert sorted(client.nlst()) == ["1", "2"]
        got = []
        client.retrbinary("RETR 1/run", got.append)
        assert b"".join(got) == (copies / "1" / "run").read_bytes()
        client.storbinary("STOR 1/run", BytesIO(b"#!/bin/sh\n"))
        client.storbinary("STOR 2/run", BytesIO((copies / "2" / "run").read_bytes()))
        client.quit()
    store = DiskStore(copies)
    assert fault_of(store, "2") is None
    assert fault_of(store, "1") == "its file run is damaged"
    command("apploader", "sfv", copies / "1")
    assert fault_of(store, "1") is None


def test_from_flash_the_copies_of_an_ftp_server_run_and_without_one_that_of_the_flash(
    tmp_path, trace, ftp
):
    top, copies = tmp_path / "storages", tmp_path / "server" / "ftp"
    command("apploader", "fill", top, "flash", make(tmp_path, "last"))
    words = ("apploader", "run", top, "--boot", "flash", "--ftp")
    with running(*words, ftp):
        eventually(lambda: trace() == ["ftp1"])
    # What is damaged there is not used.
    (copies / "1" / "run").write_text("#!/bin/sh\n")
    (top / "ftp" / "1" / "run").write_text("#!/bin/sh\n")
    with running(*words, ftp):
        eventually(lambda: trace() == ["ftp1", "ftp2"])
    with running(*words, "ftp://127.0.0.1:9/"):
        eventually(lambda: trace() == ["ftp1", "ftp2", "last"])
