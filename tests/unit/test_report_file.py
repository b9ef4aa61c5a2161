"""Where a report goes: whole into a file, and into a device without taking its place."""

import json
import os
import threading

from pipelines.report_file import write_report


def test_a_file_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "r.json"
    path.write_text("old")
    write_report(path, {"a": 1})
    assert json.loads(path.read_text()) == {"a": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_a_fifo_and_a_link_stay_what_they_are(tmp_path):
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
