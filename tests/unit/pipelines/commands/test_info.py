"""`kontur-av info`."""

from mcap.writer import Writer

from pipelines.cli import main


def test_a_file_of_another_program_is_shown(tmp_path, capsys):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="other 1.0")
        writer.add_message(writer.register_channel("/a", "json", 0), 1, b"{}", 1)
        writer.finish()
    assert main(["info", str(path)]) == 0
    assert "not a recording of kontur-av" in capsys.readouterr().out
