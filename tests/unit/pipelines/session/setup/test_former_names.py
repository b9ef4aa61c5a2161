"""Names of an earlier version are taken, each with a line."""

from pipelines.cli import main


def test_former_commands_and_inputs_are_taken_with_a_line(capfd, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert main(["owner", "iss", "--session", "none-1"]) == 2
    options = ["--setup", "spacejustin", "--source", "iss_camera=missing.mp4", "--seconds", "1"]
    assert main(["stream", *options]) == 2
    said = capfd.readouterr().err
    assert "owner is called authority now" in said and "iss is called operator now" in said
    assert "iss_camera is called operator_camera now" in said and "missing.mp4" in said
