"""The pages while their server, and then the whole session, is killed."""

import os
import signal

import pytest
from browser import LIVE, drawn, eventually, wait_for_pictures
from running_session import BOARD, RunningSession

#: Notes each change of the marks.
NOTE_MARKS = """
window.marks = [];
const picture = document.querySelector("#picture");
const note = () => marks.push({
  stale: picture.dataset.stale === "true",
  lost: document.body.dataset.link === "lost",
});
for (const one of [picture, document.body]) {
  new MutationObserver(note).observe(one, { attributeFilter: ["data-stale", "data-link"] });
}
"""
SENT_LIVE = "document.querySelector('#sent').dataset.stale === 'false'"
BOTH_MARKS = "marks.some((mark) => mark.stale && mark.lost)"


def kill_all(session):
    """Kill every process of a session, so that none sees another's end."""
    pids = session.children()
    os.kill(session.process.pid, signal.SIGSTOP)
    for pid in [*pids, session.process.pid]:
        os.kill(pid, signal.SIGKILL)


@pytest.fixture
def session(request, tmp_path):
    where = getattr(request, "param", "24200")
    with RunningSession(BOARD, "--page", where, directory=tmp_path) as running:
        running.pids()
        yield running


@pytest.fixture
def space(session, start_browser):
    page = start_browser().open(session.pages()["space"])
    page.wait(LIVE)
    wait_for_pictures(page)
    page.run(NOTE_MARKS)
    return page


def test_a_page_comes_back_when_its_server_was_killed_and_marks_a_killed_session(session, space):
    before = drawn(space)
    os.kill(session.pids()["page_space"], signal.SIGKILL)
    space.wait(BOTH_MARKS, "the mark of a lost server")
    space.wait(f"{LIVE} && document.body.dataset.link === 'connected'", "the return")
    eventually(lambda: drawn(space) > before, "new pictures")

    shown = space.pixels()
    space.run("marks.length = 0")
    kill_all(session)
    session.process.wait()
    space.wait(BOTH_MARKS, "the mark of a lost session")
    age_ms = space.figure("uplink_video.age_ms")
    # The picture stays, and becomes older on the page's own clock.
    eventually(lambda: space.figure("uplink_video.age_ms") > age_ms, "an older picture")
    assert space.pixels().shape == shown.shape
    assert space.pixels().any()
    # The marks stay. How soon they come: tests/web/silence.test.mjs.
    assert space.run("return marks.at(-1).stale && marks.at(-1).lost") is True
    assert space.run(f"return {LIVE}") is False
    # That nobody answers is no fault of the page.
    space.browser.assert_no_errors(server_gone=True)


@pytest.mark.parametrize("session", ["0.0.0.0:24200"], indirect=True)
def test_over_tls_the_picture_as_sent_comes_back_too(session, start_browser):
    address = session.pages()["ground"]
    assert address.startswith("https://")
    # Nobody has signed the certificate; a person would compare its fingerprint.
    ground = start_browser(flags=["ignore-certificate-errors"]).open(address)
    ground.wait(f"{SENT_LIVE} && document.body.dataset.link === 'connected'")
    ground.run(NOTE_MARKS)
    # The process that kept the units since their last beginning has gone.
    os.kill(session.pids()["page_ground"], signal.SIGKILL)
    ground.wait(BOTH_MARKS, "the mark of a lost server")
    ground.wait(f"{SENT_LIVE} && document.body.dataset.link === 'connected'")
    assert ground.pixels("#sent").any()
    ground.browser.assert_no_errors(server_gone=True)
