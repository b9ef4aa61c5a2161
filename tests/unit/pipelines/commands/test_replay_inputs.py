"""Files that cannot be played: one line that names the file, exit code 2, nothing started."""

import pytest
from mcap.writer import Writer
from synthetic_recording import write_recording

from kontur_av.sources.recorded_format import FORMAT
from pipelines.cli import main

#: Each of them plays the file {0}.
COMMANDS = {
    "replay": "replay {0}",
    "simulate": "simulate --replay {0}",
    "source": "stream --setup spacejustin --no-page --source head=mcap:{0}#/uplink_video/sent",
}


def not_mcap(path, _monkeypatch):
    path.write_bytes(b"a text file, say")


def of_another_program(path, _monkeypatch):
    writer = Writer(str(path))
    writer.start()
    schema = writer.register_schema("x.Y", "jsonschema", b"{}")
    channel = writer.register_channel("/x", "json", schema)
    writer.add_message(channel, 1, b"{}", 1)
    writer.finish()


def newer(path, monkeypatch):
    for module in ("channels", "facts"):
        monkeypatch.setattr(f"pipelines.recording.{module}.FORMAT", FORMAT + 1)
    write_recording(path, seconds=0.5)
    monkeypatch.undo()


FILES = {
    not_mcap: ["it is not an MCAP file"] * 2 + ["no whole MCAP file"],
    of_another_program: ["was written by mcap-python"] * 2
    + ["no channel with pictures: it has /x"],
    newer: [f"reads up to format {FORMAT}: install a newer one"] * 3,
}


@pytest.mark.parametrize(
    ("make", "command", "told"),
    [
        pytest.param(make, command, told, id=f"{make.__name__}-{name}")
        for make, lines in FILES.items()
        for (name, command), told in zip(COMMANDS.items(), lines, strict=True)
    ],
)
def test_a_file_that_cannot_be_played_is_refused(
    tmp_path, monkeypatch, capsys, make, command, told
):
    path = tmp_path / "a.mcap"
    make(path, monkeypatch)
    assert main(command.format(path).split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert str(path) in err and told in err


def test_a_channel_that_the_file_lacks_is_refused_with_those_that_it_has(tmp_path, capsys):
    path = tmp_path / "a.mcap"
    write_recording(path, seconds=0.5)
    words = COMMANDS["source"].format(path).replace("/sent", "/none").split()
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no channel '/uplink_video/none'" in line and "/uplink_video/sent" in line


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--speed", "9"], "--speed 9: take 0.1 to 4"),
        (["--seconds", "0"], "--seconds 0: give a number above 0"),
        (["--cap-kbps", "uplink_video=20"], "uplink_video needs a cap of "),
        (["--speed", "4", "--cap-kbps", "uplink_voice=8"], "STREAM=KBPS with one of uplink_video"),
        (["--report", "/none/r.json"], "--report /none/r.json"),
    ],
)
def test_options_that_cannot_work_are_refused(tmp_path, capsys, words, told):
    path = tmp_path / "a.mcap"
    write_recording(path, seconds=2.0)
    assert main(["replay", str(path), *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
