"""GStreamer, without knowledge of the link, uses it by the documents' example."""

import re
import shlex

import pytest
from common import eventually
from positions import ROOT
from programs import needs_elements, running
from running_link import RunningLink, assert_books_are_right

from pipelines.session.setup.setup_file import BUILT_IN

pytestmark = pytest.mark.interop

PICTURE_OCTETS = 320 * 240 * 3 // 2


def gst(text, log):
    """Run `gst-launch-1.0 -e` with a pipeline; Ctrl-C ends it as it ends the user's."""
    return running(log, "gst-launch-1.0", "-e", *text.split(), patience_s=10)


def pipelines_of(document):
    """Every `gst-launch-1.0` line of a document, without the command's name."""
    text = (ROOT / document).read_text(encoding="utf-8").replace("\\\n", " ")
    found = re.findall(r"^gst-launch-1\.0 (.*?)\s*&?$", text, re.MULTILINE)
    return [" ".join(shlex.split(line)) for line in found]


def test_the_documents_example_goes_through_and_shows_pictures_to_a_late_receiver(tmp_path):
    needs_elements("x264enc", "rtph264pay", "rtph264depay", "avdec_h264", "udpsink")
    lines = pipelines_of("docs/own-programs.md")
    (send,) = (line for line in lines if "port=27010" in line)
    receive = next(line for line in lines if "udpsrc port=27012" in line)
    raw = tmp_path / "out.i420"
    with RunningLink("--setup", "spacejustin", "--radio", "cable", directory=tmp_path) as link:
        entry, out = (getattr(link.topology, f"{end}_port") for end in ("entry", "exit"))
        send = send.replace("port=27010", f"port={entry('uplink_video')}")
        receive = receive.replace("port=27012", f"port={out('uplink_video')}")
        assert receive.endswith("! autovideosink")
        shown = f"filesink buffer-mode=unbuffered location={raw}"
        receive = receive.replace("autovideosink", shown)
        link.wait_for_line("ground approve")
        with gst(send, tmp_path / "send.txt") as sender:
            # For some seconds there is no receiver: the first key pictures are gone.
            for _ in range(4):
                link.wait_for_line("ground")
            with gst(receive, tmp_path / "receive.txt"):

                def decoded():
                    assert sender.poll() is None, (tmp_path / "send.txt").read_text()
                    return raw.exists() and raw.stat().st_size >= 20 * PICTURE_OCTETS

                eventually(decoded, "20 pictures")
        report = link.finish()
    up = report["link"]["uplink"]
    assert up["packets"]["uplink_video"] >= 20 and up["octets"]["video"] > 0
    assert up["refused"]["garbage"] == 0
    assert_books_are_right(report, BUILT_IN["spacejustin"])
