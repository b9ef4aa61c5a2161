"""What commands refuse: one line that names the fix, exit code 2, and nothing is begun or changed.

A row is the words after the command, with what its message must say.
"""

import os
import platform
import tempfile
from pathlib import Path

import numpy as np
import pytest
from common import free_port, write_sound
from mcap.writer import Writer
from recordings import Step, write
from synthetic_recording import write_recording

from kontur_av.sources.recorded_format import FORMAT
from pipelines.cli import MISTAKE, main
from pipelines.commands import link, stream
from pipelines.link import own_ends
from pipelines.link.key_files import make_key, trusted_path
from telepresence.link.protection.identity import MachineKey

OTHER, THIRD = (MachineKey.from_seed(bytes([n]) * 32).identity for n in (0, 1))
PLAN = ["--setup", "spacejustin", "--no-page", "--plan", "plan.toml"]
GROUND = ["--setup", "spacejustin", "--end", "ground"]
SPACE = ["--setup", "spacejustin", "--end", "space", "--peer", "127.0.0.1:27000", "--insecure"]
#: Words that stand for several, or for one that is known only later.
SHORT = {
    "TASKBOARD": ["--setup", "taskboard"],
    "GROUND": GROUND,
    "LISTEN": [*GROUND, "--listen", "0.0.0.0:27000", "--insecure"],
    "SPACE": SPACE,
    "PLAN": PLAN,
    "SECOND": ["--setup", "spacejustin", "--seconds", "1"],
    "HEAD": ["--setup", "spacejustin", "--no-page", "--source"],
    "TONE": ["--audio", "tone.wav", "--to", "127.0.0.1:5004", "--cap-kbps", "64"],
    "FILM": ["--video", "x.mp4", "--to", "127.0.0.1:5004", "--cap-kbps", "64"],
    "OTHER": [str(OTHER)],
    "MISTYPED": [str(OTHER)[:-1] + "A"],
}

REFUSALS = {
    "": {
        "": "COMMAND",
        "nonsense": "nonsense",
        "--nonsense": "--help",
        "select": "CAMERA",
        "select static": "no session is running here",
        "select static --session ../../etc": "session",
        "topology": "--setup",
    },
    "stream": {
        "": "--setup",
        "--setup spacejustine": "spacejustin or taskboard, or a file",
        "--setup missing.toml": "missing.toml: No such file",
        "TASKBOARD --sources left=x": "--help",
        "TASKBOARD --source head=scene:head": "left, right, static",
        "TASKBOARD --source left": "NAME=SPEC",
        "TASKBOARD --source left=missing.mp4": "missing.mp4",
        "TASKBOARD --source left=v4l2:/dev/null": "'/dev/null' cannot be opened",
        "TASKBOARD --source left=v4l2:/dev/video0 --source right=v4l2:/dev/../dev/video0": (
            "is that of input left"
        ),
        "--setup spacejustin --source operator_mic=v4l2:/dev/video0": "wants sound",
        "TASKBOARD --source static=page --no-page": (
            "input static: source page needs the pages: leave --no-page out"
        ),
        "--setup spacejustin --source wrist=scene:head": (
            "another camera needs a setup file of your own that names it in cameras"
        ),
        "HEAD head=mcap:foreign.mcap#/uplink_video/sent": "no channel with pictures: it has /x",
        "HEAD head=mcap:newer.mcap#/uplink_video/sent": f"reads up to format {FORMAT}: install",
        "TASKBOARD --telemetry nowhere:Battery": "there is no module 'nowhere'",
        "TASKBOARD --joystick usb": "write sim, sim:FAULT, page, ros2, evdev",
        "TASKBOARD --joystick page --no-page": "--joystick page needs the pages",
        "TASKBOARD --second-robot arm:Left": "has no partner's arm",
        "TASKBOARD --seconds 0": "--seconds 0",
        "TASKBOARD --seconds nan": "--seconds nan",
        "TASKBOARD --seed x": "--seed",
        "TASKBOARD -v -q": "-q",
        "TASKBOARD --report missing/r.json": "--report missing/r.json",
        "TASKBOARD --record notes.txt": "notes.txt exists: give another name, or --overwrite",
        "TASKBOARD --record none/a.mcap": "none",
        "TASKBOARD --record kept": "kept",
        "TASKBOARD --snapshots notes.txt/inside": "--snapshots",
        # A refused option leaves no directory behind.
        "TASKBOARD --snapshots shots --packets x": "--packets",
        "TASKBOARD --snapshots shots --ros2 x": "--ros2",
        "TASKBOARD --snapshots shots --files-rate x": "--files-rate",
        "TASKBOARD --base-port 80": "1024",
        "TASKBOARD --radio nosuch": (
            "iss-overhead, geo, lte, wifi, satellite, bad-day, or a file NAME.toml"
        ),
        "TASKBOARD --radio-delay-ms -1": "take 0 to 10000",
        "TASKBOARD --radio geo --radio-delay-ms 3": "give one of them",
        "TASKBOARD --radio-start 10": (
            "radio cable has no pass to begin in; take radio iss-pass or iss-overhead, or leave"
        ),
        "TASKBOARD --radio-delay-ms 9 --radio-start 1": "leave the start out",
        "TASKBOARD --listen 0.0.0.0:27000": "add --end ground or --end space",
        "LISTEN --joystick page": "the joystick is in space; give it at --end space",
        "LISTEN --source operator_camera=page": "operator_camera is captured at --end space; this",
        "SPACE --source left=page": "left is captured at --end ground; this end has operator_",
        "SPACE --rtc": "--rtc: a partner joins the ground; give it at --end ground",
        "SPACE --ice-server turn:192.0.2.1": "give it at --end ground",
        "LISTEN --radio iss-pass --trainer": "give it at --end space with --trainer",
        "SPACE --radio iss-pass": "give it at --end space with --trainer, and none at",
        "TASKBOARD --page 0": "port from 1 to 65534",
        "TASKBOARD --page localhost": "[HOST:]PORT",
        "TASKBOARD --page 192.0.2.1:8270": "no address of this machine",
        "TASKBOARD --page no.such.invalid:8270": "no.such.invalid",
        "TASKBOARD --page 8270 --no-page": "--no-page",
        "TASKBOARD --no-page --open": "--open needs the pages",
        "TASKBOARD --no-page --page-cert x": "--page-cert needs the pages",
        "TASKBOARD --page-cert missing.pem": "missing.pem: cannot be read",
        "TASKBOARD --files-rate 8,8": "--files-rate is for --files",
        "TASKBOARD --files . --files-rate 8": "give two rates",
        "TASKBOARD --files /proc/none": "--files /proc/none",
        "TASKBOARD --service ssh=2222": "give --files DIR, too",
        "TASKBOARD --service ssh": "NAME=PORT",
        "TASKBOARD --service ssh=2222 --service ssh=2223": "ssh is given twice",
        "TASKBOARD --service-allow ../a=127.0.0.1:22": "NAME=HOST:PORT",
        "TASKBOARD --files . --service ssh=2222": "give --service-allow ssh=HOST:PORT, too",
        "TASKBOARD --leds panel:5000": "give --tasks or --plan, too",
        "TASKBOARD --tasks --leds panel": "write HOST:PORT",
        "TASKBOARD --tasks missing.xml": "missing.xml",
        "TASKBOARD --runs runs": "--runs is for tasks",
        "TASKBOARD --tasks --runs runs --record all.mcap": "want the same recorder",
        "PLAN --tasks own.xml": "--plan names its files itself",
        "PLAN --leds 127.0.0.1:5000": "sees only the built-in LED panel",
        "LISTEN --no-page --plan plan.toml": "on one machine only",
    },
    "simulate": {
        "--setup spacejustin --seconds 1 --plan two_hands.toml": "handshake needs two hands",
        "--setup spacejustin": "--seconds is missing",
        "SECOND --source head=v4l2:/dev/x": "real time; a simulation takes scene:NAME, a media",
        "SECOND --source head=page": "real time; a simulation takes scene:NAME, a media file",
        "SECOND --select 0=roof": "roof",
        "SECOND --select soon=head": "soon",
        "SECOND --select 1=head": "head",
        "SECOND --encode-ms -1": "--encode-ms",
        "SECOND --decode-ms 5000": "--decode-ms",
        "TASKBOARD --seconds 1 --joystick=page": "lives in real time",
        "TASKBOARD --seconds 1 --joystick=evdev": "lives in real time",
        "TASKBOARD --seconds 1 --robot=udp:h:1": "lives in real time",
        "--replay alien.mcap": "alien.mcap: it is not an MCAP file",
        "--replay none.mcap": "No such file",
        "--replay a.mcap --cap-kbps uplink_video=30": "uplink_video needs a cap of ",
        "--replay a.mcap --cap-kbps downlink_voice=20": "downlink_voice needs a cap of 6",
        "--replay a.mcap --cap-kbps sidelink=20": "write STREAM=KBPS with one of uplink_video",
        "--replay a.mcap --source head=scene:head": "--source changes what is sent",
        "--replay a.mcap --select 1=head": "--select changes what is sent",
        "--replay a.mcap --radio nowhere": "nowhere",
    },
    "link": {
        "": "--setup",
        "TASKBOARD --seconds 0": "above 0",
        "TASKBOARD --report missing/r.json": "--report missing/r.json",
        "TASKBOARD --end moon": "--end",
        "TASKBOARD --peer 192.0.2.7:27001": "add --end ground or --end space",
        "TASKBOARD --insecure": "--insecure is for one end alone",
        "TASKBOARD --key k": "--key is for one end alone",
        "TASKBOARD --radio lte": "radio lte has a network, for `simulate` and `sweep`",
        "TASKBOARD --path-batch-ms 2": "--path-batch-ms is for one end alone",
        "TASKBOARD --path compact": "--path is for one end alone",
        "GROUND --listen 127.0.0.1:9 --path-batch-ms 3": "path_batch_ms 3: take 1, 2 or 4",
        "TASKBOARD --apps-bind 127.0.0.1": "--apps HOST",
        "TASKBOARD --apps no_host": "no_host",
        "TASKBOARD --apps 192.0.2.7": "--apps-bind",
        "TASKBOARD --apps 0.0.0.0": "--apps 0.0.0.0: give the address of one",
        "GROUND": "needs --listen ADDR:PORT to wait for the other end, or --peer HOST:PORT",
        "GROUND --peer 127.0.0.1": "--peer '127.0.0.1': write HOST:PORT",
        "GROUND --peer [::]:27001": "--peer [::]:27001: give the address of one",
        "GROUND --peer 0.0.0.0:27001": "--peer 0.0.0.0:27001: give the address of one",
        "GROUND --peer 255.255.255.255:27001": "cannot be reached",
        "GROUND --peer 127.0.0.1:1 --listen 127.0.0.1:2": "give one of them",
        "GROUND --listen 27000": "--listen '27000': write HOST:PORT",
        "GROUND --listen 0.0.0.0:27010": "this end uses the ports 27000 to 27039 itself",
        "GROUND --listen 192.0.2.77:9000 --insecure": "no address of this machine",
        "GROUND --listen 0.0.0.0:27000": "there is no key",
        "GROUND --listen 0.0.0.0:27000 --key mine": "`kontur-av keys new` makes one",
        "LISTEN --key k": "--insecure and --key: give one of them",
        "GROUND --listen 127.0.0.1:27000 --key key.pem": "trusts nobody: `kontur-av keys trust",
        "GROUND --listen 127.0.0.1:27000 --key two.pem": "name the peer's by --identity",
        "GROUND --listen 127.0.0.1:27000 --key two.pem --identity nobody": "characters instead of",
    },
    "keys": {
        "new --key key.pem": "exists: a new key is a new identity",
        "show --key none.pem": "`kontur-av keys new` makes one",
        "show --key .": "is no file",
        "show --key fifo": "is no file",
        "show --key group.pem": "chmod 600 group.pem",
        "show --key writable.pem": "chmod 600 writable.pem",
        "show --key damaged.pem": "no private key",
        "trust OTHER --key none.pem": "keys new",
        "trust OWN --key key.pem": "that of the other one",
        "trust MISTYPED --key key.pem": "mistyped",
        "forget OTHER --key key.pem": "is not trusted",
        "list --key noted.pem": "noted.pem.trusted, line 3: identity 'nonsense'",
        "list --key lax.pem": "chmod go-w",
    },
    "send": {
        "TONE --audio missing.wav": "missing.wav",
        "TONE --audio page": "only a session has the source page",
        "TONE --to 127.0.0.1:99999": "65534",
        "TONE --cap-kbps -3": "above 0",
        "TONE --cap-kbps 6": "a cap of 6 kbit/s: ",
        "TONE --channel-kbps 60": "lower the cap",
        "TONE --seconds 0": "above 0",
        "TONE --sdp /nowhere/x.sdp": "name a file in an open folder",
        "FILM --size 641x480": "even",
    },
    "receive": {
        "--sdp -s.sdp": "--sdp=VALUE",
        "--sdp none.sdp": "cannot be read",
        "--sdp notes.txt": "no SDP",
        "--sdp good.sdp --seconds 1 --save /nowhere/x.mkv": "--save",
        "--sdp good.sdp --seconds 1 --play jack:x": "write default, alsa:DEVICE or pulse:SINK",
    },
    "joystick": {
        "test --device usb": "write sim, sim:FAULT, page, ros2, evdev",
        "test --device page": "stream --joystick page`; its mechanics",
        "test --device sim:tired": "the faults are stuck-x",
    },
    "info": {
        "-a.mcap": "./NAME",
        "none.mcap": "cannot be read: No such file",
        ".": "is no file",
        "empty.mcap": "it is not an MCAP file",
        "alien.mcap": "it is not an MCAP file",
    },
    "recover": {
        "none.mcap": "cannot be read: No such file",
        "alien.mcap": "it is not an MCAP file",
        "foreign.mcap": "written by other 1.0, not by kontur-av",
        "torn.mcap --out notes.txt": "exists: give another name, or --overwrite",
        "torn.mcap --out torn.mcap --overwrite": "is the torn recording itself",
        "torn.mcap --out none/b.mcap": "none/b.mcap cannot be written: No such file",
    },
    "replay": {
        "alien.mcap": "alien.mcap: it is not an MCAP file",
        "foreign.mcap": "was written by other 1.0",
        "newer.mcap": f"reads up to format {FORMAT}: install a newer one",
        "a.mcap --speed 9": "--speed 9: take 0.1 to 4",
        "a.mcap --cap-kbps uplink_video=20": "uplink_video needs a cap of ",
        "a.mcap --speed 4 --cap-kbps uplink_voice=8": "STREAM=KBPS with one of uplink_video",
        "a.mcap --report /none/r.json": "--report /none/r.json",
    },
    "export": {
        "a.mcap": "give at least one of",
        "a.mcap --csv x --mat73": "give --mat OUT.mat, too",
        "a.mcap --mat /proc/out.mat": "cannot be written",
        "a.mcap --mat a.mcap --overwrite": "is the recording itself",
        "a.mcap --csv a.mcap": "is no directory",
        "a.mcap --mat out.mat --csv kept": "events.csv exists: give another name, or --overwrite",
        "alien.mcap --mat out.mat": "is not an MCAP file",
    },
    "bench": {
        "cpu --runs 0": "--runs 0",
        "cpu --seconds 1": "--seconds 1",
        "cpu --against /nowhere": "--against /nowhere",
        "latency --seconds 0": "--seconds 0",
        "latency --live-seconds 0.5": "--live-seconds 0.5",
        "latency --radio nowhere": "nowhere",
        "latency --load 65": "--load 65",
        "latency --base-port 80": "base port 80",
        "latency --plot lead.jpg": "--plot",
        "latency --no-live --live-seconds 3": "--live-seconds",
        "link --report /nowhere/a.json": "--report",
        "link --setup nowhere": "nowhere",
        "sync --video a.mp4": "",
        "sync --video a.mp4 --audio a.mp4 --seconds 5": "give one of them",
        "sync --video a.mp4 --audio a.mp4 --offset-ms haptics=3": "--offset-ms",
        "sync --video a.mp4 --audio a.mp4 --roi 1,2,3": "--roi",
        "sync --offset-ms video=3": "--offset-ms",
        "video --seconds 9999": "--seconds 9999",
        "video --cap-kbps 5": "--cap-kbps 5",
        "video --cap-kbps 100": "--channel-kbps 88",
        "video --clip nowhere.mp4": "nowhere.mp4",
        "video --size 64x48": "--size 64x48",
        f"video --clip {__file__} {__file__}": "there is another clip of this name",
    },
    "record": {
        "r.mcap": "no session is running",
        "r.mcap --seconds 1": "no session is running",
    },
    "robot check": {"sim:x": "'sim:x' cannot be made"},
    "yamcs new": {"out --http-port 99999": "--http-port: no port 99999: take 1 to 65535"},
    "apploader sfv": {"missing": "missing is no folder", "fifos": "fifo is no regular file"},
}
ROWS = [
    (f"{command} {words}".strip(), says)
    for command, rows in REFUSALS.items()
    for words, says in rows.items()
]


def _write_recordings(folder):
    write_recording(folder / "a.mcap", seconds=2.0)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("channels", "metadata"):
            patch.setattr(f"pipelines.recording.{module}.FORMAT", FORMAT + 1)
        write_recording(folder / "newer.mcap", seconds=0.5)
    steps = [Step(100_000_000, count % 2, 0, b"12345") for count in range(20)]
    (folder / "torn.mcap").write_bytes(write(steps).octets[:-500])
    (folder / "empty.mcap").touch()
    (folder / "alien.mcap").write_bytes(b"RIFF and more")
    with (folder / "foreign.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(library="other 1.0")
        schema = writer.register_schema("x.Y", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/x", "json", schema), 1, b"{}", 1)
        writer.finish()


def _write_keys(folder):
    modes = {"group.pem": 0o640, "world.pem": 0o604, "writable.pem": 0o620}
    for name in ("key.pem", "two.pem", "noted.pem", "lax.pem", "damaged.pem", *modes):
        make_key(folder / name)
        (folder / name).chmod(modes.get(name, 0o600))
    text = (folder / "damaged.pem").read_bytes()
    (folder / "damaged.pem").write_bytes(text.replace(b"BEGIN PRIVATE", b"BEGIN PIRATE"))
    for name, lines in {
        "two.pem": f"{OTHER}\n{THIRD}\n",
        "noted.pem": "# a note\n\nnonsense\n",
        "lax.pem": f"{OTHER}\n",
    }.items():
        trusted_path(folder / name).write_text(lines)
        trusted_path(folder / name).chmod(0o620 if name == "lax.pem" else 0o600)
    os.mkfifo(folder / "fifo", 0o600)
    (folder / "fifos").mkdir()
    os.mkfifo(folder / "fifos" / "fifo")


@pytest.fixture(scope="module")
def folder():
    """A directory with what the rows name; also that of the sessions, of which none runs."""
    # Not tmp_path, because the path of a socket must be short.
    with tempfile.TemporaryDirectory(prefix="kav") as name, pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", f"{name}/temporary")
        patch.setenv("XDG_CONFIG_HOME", f"{name}/none")
        patch.chdir(name)
        here = Path(name)
        (here / "temporary").mkdir()
        (here / "notes.txt").write_text("no film at all")
        (here / "plan.toml").write_text('[[task]]\nname = "line"\n')
        (here / "two_hands.toml").write_text('[[task]]\nname = "handshake"\n')
        (here / "mic.toml").write_text(
            "cameras = ['stereo', 'a_mic']\n[uplink_video]\ncap_kbps = 85\n"
            "[sources]\na_mic = 'scene:static'\n"
        )
        (here / "good.sdp").write_text(
            f"v=0\nc=IN IP4 127.0.0.1\nm=audio {free_port(more=1)} RTP/AVP 97\n"
            "a=rtpmap:97 opus/48000/2\n"
        )
        (here / "kept").mkdir()
        (here / "kept" / "events.csv").write_text("precious")
        write_sound(here / "tone.wav", np.zeros(48_000))
        _write_recordings(here)
        _write_keys(here)
        yield here


@pytest.fixture(autouse=True)
def nothing_starts(monkeypatch):
    def start(*_, **__):
        pytest.fail("something was started")

    for module in (stream, link):
        monkeypatch.setattr(module, "Launcher", start)


def state_of(folder):
    found = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        found[path] = (status.st_size, status.st_mtime_ns if path.is_file() else 0)
    return found


def refused(capsys, *words):
    """The one line with which a command is refused."""
    assert main([str(word) for word in words]) == MISTAKE == 2
    out, error = capsys.readouterr()
    (line,) = error.splitlines()
    assert out == "" and line.startswith("kontur-av: ")
    return line


@pytest.mark.rule("7")
@pytest.mark.parametrize(("words", "says"), ROWS, ids=[words[:60] for words, _ in ROWS])
def test_a_mistake_is_one_line_that_names_the_mend(folder, capsys, words, says):
    capsys.readouterr()
    before = state_of(folder)
    known = SHORT
    if "OWN" in words:
        main(["keys", "show", "--key", "key.pem"])
        known = SHORT | {"OWN": capsys.readouterr().out.split()}
    assert says in refused(capsys, *(w for word in words.split() for w in known.get(word, [word])))
    assert state_of(folder) == before


def test_what_was_written_wrong_stands_in_one_line_and_version_is_printed(capsys):
    for name in ("a\nb", "a\x1b[31m", "a\u2028b", "a\r"):
        line = refused(capsys, "topology", "--setup", f"{name}.toml")
        assert line.isprintable() and line.startswith("kontur-av: cannot read setup a\\")
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("kontur-av 0.")


def test_another_machine_needs_an_address_of_this_one_and_another_system_is_refused(
    capsys, monkeypatch
):
    for near, says in (
        ("198.51.100.4", "add --apps-bind 198.51.100.4"),
        (None, "cannot be reached from here"),
    ):
        monkeypatch.setattr(own_ends, "reaches", lambda peer, near=near: near)
        assert says in refused(capsys, "link", "--setup", "taskboard", "--apps", "192.0.2.7")

    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    for command in ("stream", "simulate", "devices", "bench"):
        assert "Darwin is not supported: " in refused(capsys, command)
