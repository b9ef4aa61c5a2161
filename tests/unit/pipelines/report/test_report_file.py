"""A report replaces a file as a whole, and is written into a device without replacing it."""

import json
import os
import threading
from pathlib import Path

import pytest

from kontur_av.errors import ConfigError
from pipelines.report.report_file import check_writable, save_report, write_report


def test_a_fifo_and_a_link_are_not_replaced_and_a_device_is_writable(tmp_path, monkeypatch):
    fifo, link, target = tmp_path / "fifo", tmp_path / "link", tmp_path / "target"
    os.mkfifo(fifo)
    got = []
    reader = threading.Thread(target=lambda: got.append(fifo.read_text()))
    reader.start()
    write_report(fifo, {"a": 1})
    reader.join(10)
    assert json.loads(got[0]) == {"a": 1}
    assert fifo.is_fifo()
    target.write_text("old")
    link.symlink_to(target)
    write_report(link, {"b": 2})
    assert link.is_symlink()
    assert json.loads(target.read_text()) == {"b": 2}
    monkeypatch.setattr(os, "access", lambda path, mode: not Path(path).is_dir())
    check_writable(Path("/dev/null"))
    for path in (tmp_path / "r.json", tmp_path):
        with pytest.raises(ConfigError, match="cannot be written"):
            check_writable(path)


@pytest.mark.parametrize("name", ["link", "plain"])
def test_an_interrupt_leaves_what_was_there_and_nothing_else(name, tmp_path, monkeypatch):
    (tmp_path / "plain").write_text("old")
    (tmp_path / "link").symlink_to("plain")
    write = Path.write_text

    def interrupted(path, text, **options):
        write(path, text[: len(text) // 2], **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_text", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_report(tmp_path / name, {"a": 1})
    assert (tmp_path / "plain").read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {"plain", "link"}


def test_a_report_that_has_no_room_is_kept_elsewhere_or_goes_to_standard_error(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert not save_report(Path("/dev/full"), {"kept": 1})
    said = capsys.readouterr().err
    (kept,) = tmp_path.iterdir()
    assert (
        said == f"kontur-av: --report /dev/full: No space left on device; the report is in {kept}\n"
    )
    assert json.loads(kept.read_text()) == {"kept": 1}
    monkeypatch.setattr("tempfile.gettempdir", lambda: "/nowhere")
    assert not save_report(Path("/dev/full"), {"kept": 2})
    first, *rest = capsys.readouterr().err.splitlines()
    assert first.endswith("No space left on device; the report follows")
    assert json.loads("\n".join(rest)) == {"kept": 2}


def test_a_report_with_room_replaces_a_file_as_a_whole(tmp_path, capsys):
    path = tmp_path / "r.json"
    path.write_text("old")
    assert save_report(None, {}) and save_report(path, {"kept": 3})
    assert json.loads(path.read_text()) == {"kept": 3}
    assert list(tmp_path.iterdir()) == [path]
    assert capsys.readouterr().err == ""
