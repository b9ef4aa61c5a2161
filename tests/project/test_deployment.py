"""The systemd unit is one that systemd takes, and the clip of the documents is there."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import av
import pytest
from positions import ROOT

from kontur_av.sources.spec import check_spec

UNIT = ROOT / "samples" / "kontur-av@.service"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_takes_the_unit(tmp_path):
    text = UNIT.read_text(encoding="utf-8")
    assert "\nUser=kontur\n" in text and "[Install]" in text
    assert "SupplementaryGroups=video audio input\n" in text and "StateDirectory=" in text
    # The address of the pages is said, and no report replaces another.
    (start,) = re.findall("ExecStart=(.*)", text)
    assert " -q" not in start and '--report "%i-$$(date' in start
    # What it starts must exist.
    program = Path(sys.executable).with_name("kontur-av")
    copy = tmp_path / "kontur-av@lab.service"
    copy.write_text(text.replace("/opt/kontur/bin/kontur-av", str(program)))
    done = subprocess.run(["systemd-analyze", "verify", copy], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_script_makes_the_documents_clip_which_is_in_the_package(tmp_path, monkeypatch):
    script = ROOT / "samples" / "make_clip.py"
    subprocess.run([sys.executable, script, tmp_path], check=True, timeout=60)
    made, kept = (folder / "clip.mp4" for folder in (tmp_path, ROOT / "samples"))
    for path in (made, kept):
        with av.open(str(path)) as container:
            assert len(list(container.decode(video=0))) == 60
    monkeypatch.chdir(tmp_path)
    check_spec("clip.mp4", "video")
    (tmp_path / "clip.mp4").write_text("a file of one's own goes first")
    with pytest.raises(Exception, match="no media file"):
        check_spec("clip.mp4", "video")
