"""The pages while their server, and then the whole session, is killed."""

import os
import signal

import pytest
from browser import LIVE, drawn, eventually, wait_for_pictures
from running_session import RunningSession

#: What the page may take to mark that nobody answers, beside the time in which it could not run.
MARK_MS = 300
#: Notes each change of the marks with the page's instant, and all the time without a turn.
NOTE_MARKS = """
window.marks = [];
window.gapMs = 0;
const picture = document.querySelector("#picture");
const note = () => marks.push({
  ms: performance.timeOrigin + performance.now(),
  stale: picture.dataset.stale === "true",
  lost: document.body.dataset.link === "lost",
});
for (const one of [picture, document.body]) {
  new MutationObserver(note).observe(one, { attributeFilter: ["data-stale", "data-link"] });
}
let turnMs = performance.now();
setInterval(() => {
  if (performance.now() - turnMs > 30) gapMs += performance.now() - turnMs;
  turnMs = performance.now();
}, 10);
"""
FORGET_MARKS = "marks.length = 0; gapMs = 0;"
SENT_LIVE = "document.querySelector('#sent').dataset.stale === 'false'"
BOTH_MARKS = "marks.find((mark) => mark.stale && mark.lost)?.ms"


def kill_all(session):
    """Kill every process of a session, so that none sees another's end."""
    pids = session.children()
    os.kill(session.process.pid, signal.SIGSTOP)
    for pid in [*pids, session.process.pid]:
        os.kill(pid, signal.SIGKILL)


def now_ms(page):
    return page.run("return performance.timeOrigin + performance.now()")


@pytest.fixture
def session(request, tmp_path):
    where = getattr(request, "param", "24200")
    with RunningSession("taskboard", "--page", where, directory=tmp_path) as running:
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
    killed_ms, before = now_ms(space), drawn(space)
    os.kill(session.pids()["page_space"], signal.SIGKILL)
    space.wait(BOTH_MARKS, "the mark of a lost server")
    space.wait(f"{LIVE} && document.body.dataset.link === 'connected'", "the return")
    print(f"a page was back {now_ms(space) - killed_ms:.0f} ms after its server was killed")
    eventually(lambda: drawn(space) > before, "new pictures")

    shown = space.pixels()
    space.run(FORGET_MARKS)
    kill_all(session)
    dead_ms = now_ms(space)
    session.process.wait()
    marked_ms = space.wait(BOTH_MARKS, "the mark of a lost session")
    gap_ms = space.run("return gapMs")
    print(f"marked {marked_ms - dead_ms:.0f} ms after the end; not running for {gap_ms:.0f} ms")
    assert marked_ms - dead_ms <= MARK_MS + gap_ms
    age_ms = space.figure("uplink_video.age_ms")
    # The picture stays, and becomes older on the page's own clock.
    eventually(lambda: space.figure("uplink_video.age_ms") > age_ms, "an older picture")
    assert space.pixels().shape == shown.shape
    assert space.pixels().any()
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
    killed_ms = ground.wait(BOTH_MARKS, "the mark of a lost server")
    ground.wait(f"{SENT_LIVE} && document.body.dataset.link === 'connected'")
    print(f"the sent picture was back after {now_ms(ground) - killed_ms:.0f} ms")
    assert ground.pixels("#sent").any()
    ground.browser.assert_no_errors(server_gone=True)
