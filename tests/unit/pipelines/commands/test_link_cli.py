"""`kontur-av link`: mistakes are one line that names the mend; every channel has its ports."""

import pytest
from places import ROOT

from pipelines.cli import main
from pipelines.commands import link
from pipelines.link import own_ends
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Segment
from pipelines.session.topology.tables import ports_table
from pipelines.table import topology_of
from telepresence.link.protection.identity import MachineKey

TASKBOARD, SPACEJUSTIN = BUILT_IN["taskboard"], BUILT_IN["spacejustin"]
GROUND = ["--setup", "taskboard", "--end", "ground"]


@pytest.fixture(autouse=True)
def nothing_starts(monkeypatch):
    def start(*_, **__):
        pytest.fail("a link was started")

    monkeypatch.setattr(link, "Launcher", start)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], "--setup"),
        (["--setup", "nosuch"], "spacejustin or taskboard, or a file"),
        (
            ["--setup", "taskboard", "--radio", "nosuch"],
            "clean, iss-pass, iss-overhead, geo",
        ),
        (["--setup", "taskboard", "--radio", "missing.toml"], "missing.toml"),
        (["--setup", "taskboard", "--seconds", "0"], "above 0"),
        (["--setup", "taskboard", "--report", "missing/r.json"], "--report missing/r.json"),
        (["--setup", "taskboard", "--base-port", "80"], "1024"),
        (["--setup", "taskboard", "--end", "moon"], "--end"),
        (["--setup", "taskboard", "--peer", "192.0.2.7:27001"], "add --end ground or --end space"),
        (["--setup", "taskboard", "--listen", "0.0.0.0:1"], "add --end ground or --end space"),
        (["--setup", "taskboard", "--insecure"], "--insecure is for one end alone"),
        (["--setup", "taskboard", "--key", "k"], "--key is for one end alone"),
        (["--setup", "taskboard", "--apps-bind", "127.0.0.1"], "--apps HOST"),
        (["--setup", "taskboard", "--apps", "no host"], "no host"),
        (["--setup", "taskboard", "--apps", "192.0.2.7"], "--apps-bind"),
        (GROUND, "needs --listen ADDR:PORT to wait for the other end, or --peer HOST:PORT"),
        ([*GROUND, "--peer", "127.0.0.1"], "--peer '127.0.0.1': write HOST:PORT"),
        ([*GROUND, "--peer", "::1:27001"], "--peer '::1:27001': write HOST:PORT"),
        ([*GROUND, "--peer", "[::1]:27001"], "no IPv4 host"),
        ([*GROUND, "--peer", "0.0.0.0:27001"], "--peer 0.0.0.0:27001: give the address of one"),
        ([*GROUND, "--peer", "224.0.0.1:27001"], "give the address of one machine"),
        ([*GROUND, "--peer", "255.255.255.255:27001"], "cannot be reached"),
        ([*GROUND, "--peer", "127.0.0.1:1", "--listen", "127.0.0.1:2"], "give one of them"),
        ([*GROUND, "--listen", "27000"], "--listen '27000': write HOST:PORT"),
        ([*GROUND, "--listen", "224.0.0.1:27000"], "give the address of one machine"),
        ([*GROUND, "--listen", "0.0.0.0:27010"], "this end uses the ports 27000 to 27039 itself"),
        ([*GROUND, "--listen", "192.0.2.77:9000", "--insecure"], "no address of this machine"),
        ([*GROUND, "--listen", "0.0.0.0:27000"], "there is no key"),
        ([*GROUND, "--listen", "0.0.0.0:27000", "--key", "mine"], "`kontur-av keys new` makes one"),
        ([*GROUND, "--listen", "0.0.0.0:27000", "--key", "k", "--insecure"], "leave --key out"),
        (["--setup", "taskboard", "--apps", "0.0.0.0"], "--apps 0.0.0.0: give the address of one"),
    ],
)
def test_impossible_options_are_refused(capsys, tmp_path, monkeypatch, options, says):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "none"))
    assert main(["link", *options]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    (line,) = error.splitlines()
    assert says in line
    assert list(tmp_path.iterdir()) == []


def test_an_end_needs_somebody_to_trust(capsys, tmp_path):
    key = tmp_path / "key.pem"
    listen = ["link", *GROUND, "--listen", "127.0.0.1:27000", "--key", str(key)]
    assert main(["keys", "new", "--key", str(key)]) == 0
    assert main(listen) == 2
    assert "trusts nobody: `kontur-av keys trust" in capsys.readouterr().err
    two = [MachineKey.from_seed(bytes([n]) * 32).identity for n in (1, 2)]
    for identity in two:
        assert main(["keys", "trust", str(identity), "--key", str(key)]) == 0
    assert main(listen) == 2
    assert "name the peer's by --identity" in capsys.readouterr().err
    assert main([*listen, "--identity", "nobody"]) == 2
    assert "characters instead of" in capsys.readouterr().err


def test_another_machine_s_programs_need_an_address_of_this_one(capsys, monkeypatch):
    monkeypatch.setattr(own_ends, "reaches", lambda peer: "198.51.100.4")
    assert main(["link", "--setup", "taskboard", "--apps", "192.0.2.7"]) == 2
    assert "add --apps-bind 198.51.100.4" in capsys.readouterr().err
    monkeypatch.setattr(own_ends, "reaches", lambda peer: None)
    assert main(["link", "--setup", "taskboard", "--apps", "192.0.2.7"]) == 2
    assert "cannot be reached from here" in capsys.readouterr().err


@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=BUILT_IN)
def test_every_channel_of_a_setup_has_a_line_with_its_ports(setup):
    session = topology_of(setup)
    table = ports_table(session, list(Segment), "127.0.0.1", "127.0.0.1")
    rows = {row[0]: row[1:3] for row in table.rows}
    for row in session.streams:
        ports = (row.entry_port, row.exit_port)
        assert rows[row.name] == tuple(f"127.0.0.1:{port}" for port in ports)
    # The robot is on the ground and the joystick in space.
    assert session.haptic("up").sender == "robot"
    assert session.haptic("down").sender == "joystick"


def test_one_end_shows_and_binds_its_own_ports_only():
    table = topology_of(SPACEJUSTIN)
    lines = ports_table(table, [Segment.GROUND], "198.51.100.1", "198.51.100.2").lines(200)
    video = next(line for line in lines if line.startswith("uplink_video "))
    assert "198.51.100.1:27010" in video
    assert "the other end" in video
    down = next(line for line in lines if line.startswith("downlink_video "))
    assert "198.51.100.2:27020" in down
    both = [set(table.ports_of(table.gateway(end).name)) for end in Segment]
    assert both[0] & both[1] == set()
    for end, bound in zip(Segment, both, strict=True):
        shown = {row.entry_port for row in table.streams if row.direction.sender is end}
        assert len(bound - shown) == 1  # the radio's


@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=BUILT_IN)
def test_the_ports_of_the_documentation_are_those_of_the_link(setup):
    text = (ROOT / "docs" / "gateways.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| `")]
    column = {"spacejustin": 6, "taskboard": 7}[setup.name]
    documented = [
        (row[1].strip(" `"), int(row[3]), int(row[4])) for row in rows if row[column].strip()
    ]
    assert documented == [
        (row.name, row.entry_port, row.exit_port) for row in topology_of(setup).streams
    ]
