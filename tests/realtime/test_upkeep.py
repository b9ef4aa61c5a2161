"""Real programs from a directory of versions, and from AppLoader's storages."""

import ftplib
import json
import sys
import threading
from io import BytesIO
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from running_link import RunningLink, free_base_port, listening
from upkeep_programs import command, make, running, until

from pipelines.link.key_files import make_key
from pipelines.upkeep.desk import DiskStore
from pipelines.upkeep.loader_keeper import serve_ftp
from telepresence.upkeep.manifest import fault_of

pytestmark = pytest.mark.realtime

REFUSED = '{"contact": true, "passed": false, "stuck": true}'


@pytest.fixture
def trace(tmp_path, monkeypatch):
    """trace(): the names of the programs that have started, in order."""
    path = tmp_path / "trace"
    path.touch()
    monkeypatch.setenv("TRACE", str(path))
    return lambda: path.read_text().split()


def test_versions_that_fail_are_replaced_by_the_last_that_worked(tmp_path, trace):
    key, top = tmp_path / "key.pem", tmp_path / "versions"
    make_key(key)
    folders = [
        make(tmp_path, "elementary"),
        make(tmp_path, "v1"),
        make(tmp_path, "deaf", REFUSED),
        make(tmp_path, "broken", text="#!/bin/sh\necho {name} >> $TRACE\nexit 1\n"),
    ]
    for folder in folders:
        command("versions", "sign", folder, "--key", key)
        command("versions", "add", top, folder, "--key", key)

    def states():
        lines = command("versions", "list", top).splitlines()
        return {line.split()[0]: " ".join(line.split()[1:]) for line in lines}

    with running("versions", "run", top, "--key", key, "--probation", 1):
        until(lambda: trace() == ["elementary"])
        command("versions", "start", top, "v1")
        until(lambda: states()["v1"] == "executable runs")
        command("versions", "start", top, "deaf")
        until(lambda: states()["v1"] == "executable runs")
        assert states()["deaf"] == "defective set aside" or states()["deaf"] == "defective"
        command("versions", "start", top, "broken")
        until(lambda: states()["v1"] == "executable runs")
        assert states()["broken"].startswith("defective")
    assert trace() == ["elementary", "v1", "deaf", "v1", "broken", "broken", "broken", "v1"]
    # After a restart the one that worked starts again; one that is damaged does not.
    (top / "v1" / "run").write_text("#!/bin/sh\n")
    with running("versions", "run", top, "--key", key):
        until(lambda: trace()[-1] == "elementary")
    assert states()["v1"] == "defective set aside"


def test_a_program_ends_with_a_killed_keeper_and_the_next_keeper_starts_it(tmp_path, trace):
    key, top = tmp_path / "key.pem", tmp_path / "versions"
    make_key(key)
    folder = make(tmp_path, "elementary")
    command("versions", "sign", folder, "--key", key)
    command("versions", "add", top, folder, "--key", key)
    with running("versions", "run", top, "--key", key) as keeper:
        until(lambda: trace() == ["elementary"] and (top / ".status").exists())
        program = Path("/proc") / (tmp_path / "trace.pid").read_text().strip()
        keeper.kill()
        until(lambda: not program.exists())
    with running("versions", "run", top, "--key", key):
        until(lambda: trace() == ["elementary", "elementary"])


#: A gateway whose supervision says that it has another version of the link.
GATEWAY = """#!/bin/sh
echo {{name}} >> "$TRACE"
exec {python} -c '
from telepresence.link.supervision.message import Configuration
Configuration.__init__.__kwdefaults__["version"] = {{status}}
from pipelines.cli import main
raise SystemExit(main(["link", "-q", "--setup", "spacejustin", "--insecure", *{options}]))'
"""


def test_a_gateway_that_the_peer_refuses_is_replaced_and_data_passes_again(tmp_path, trace):
    key, top = tmp_path / "key.pem", tmp_path / "versions"
    make_key(key)
    listen = f"127.0.0.1:{free_base_port()}"
    with RunningLink(
        "--setup",
        "spacejustin",
        "--end",
        "ground",
        "--insecure",
        "--listen",
        listen,
        directory=tmp_path,
    ) as ground:
        base = free_base_port()
        options = json.dumps(["--end", "space", "--peer", listen, "--base-port", str(base)])
        program = GATEWAY.format(python=sys.executable, options=options)
        for name, version in (("elementary", 3), ("v1", 3), ("v2", 4)):
            folder = make(tmp_path, name, version, program)
            command("versions", "sign", folder, "--key", key)
            command("versions", "add", top, folder, "--key", key)
        command("versions", "start", top, "v1")
        entries = [
            ground.topology.entry_port("uplink_maintenance"),
            base + ground.topology.entry_port("downlink_maintenance") - ground.base_port,
        ]

        def listed(line):
            with listening(0) as anyone:
                for port in entries:
                    anyone.sendto(b"both ways", ("127.0.0.1", port))
            return line in [" ".join(one.split()) for one in listing()]

        def listing():
            return command("versions", "list", top).splitlines()

        with running("versions", "run", top, "--key", key, "--probation", 6):
            until(lambda: listed("v1 executable runs"))
            command("versions", "start", top, "v2")
            until(lambda: listed("v2 defective"))
            until(lambda: listed("v1 executable runs"))
            assert trace() == ["v1", "v2", "v1"]


def test_a_broken_update_of_the_joystick_falls_back_and_a_good_one_is_copied(tmp_path, trace):
    top = tmp_path / "storages"
    first = make(tmp_path, "first")
    for copy in ("sd/1", "sd/2", "flash"):
        command("apploader", "fill", top, copy, first)
    broken = make(tmp_path, "broken", text="#!/bin/sh\necho {name} >> $TRACE\nexit 1\n")
    command("apploader", "update", top, broken)

    def told():
        return json.loads((top / "housekeeping.json").read_text())

    with running("apploader", "run", top) as loader:
        until(lambda: trace() == ["broken", "first"])
        until(lambda: told()["copy"] == "sd/2" and told()["step"] == "running")
        until(lambda: told()["flash"]["files_checked"] >= 1)
        assert list(told()["erroneous"]) == ["sd/1"]
        assert told()["flash"]["sound"]
        command("apploader", "shutdown", top)
        assert loader.wait(30) == 0
    assert "desired mode  backup" in command("apploader", "list", top)


@pytest.fixture
def ftp(tmp_path):
    """The URL of a server with two copies, whose programs are called ftp1 and ftp2."""
    pytest.importorskip("pyftpdlib")
    top = tmp_path / "server"
    for copy in ("ftp/1", "ftp/2"):
        command("apploader", "fill", top, copy, make(tmp_path, copy.replace("/", "")))
    lines, stop = [], threading.Event()
    server = threading.Thread(
        target=serve_ftp, args=(top / "ftp", ("127.0.0.1", 0), lines.append, stop.is_set)
    )
    server.start()
    try:
        until(lambda: lines)
        yield lines[0]
    finally:
        stop.set()
        server.join(30)


def test_ftp_serves_both_copies(tmp_path, ftp):
    url, copies = urlsplit(ftp), tmp_path / "server" / "ftp"
    with ftplib.FTP() as client:
        client.connect(url.hostname, url.port, 10)
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
    # An upload without its list of checksums leaves a copy that is not used.
    assert fault_of(store, "1") == "its file run is damaged"


def test_from_flash_the_copies_of_an_ftp_server_run_and_without_one_that_of_the_flash(
    tmp_path, trace, ftp
):
    top, copies = tmp_path / "storages", tmp_path / "server" / "ftp"
    command("apploader", "fill", top, "flash", make(tmp_path, "last"))
    with running("apploader", "run", top, "--boot", "flash", "--ftp", ftp):
        until(lambda: trace() == ["ftp1"])
    # What is damaged there is not used.
    (copies / "1" / "run").write_text("#!/bin/sh\n")
    (top / "ftp" / "1" / "run").write_text("#!/bin/sh\n")
    with running("apploader", "run", top, "--boot", "flash", "--ftp", ftp):
        until(lambda: trace() == ["ftp1", "ftp2"])
    with running("apploader", "run", top, "--boot", "flash", "--ftp", "ftp://127.0.0.1:9/"):
        until(lambda: trace() == ["ftp1", "ftp2", "last"])
