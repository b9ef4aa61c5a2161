"""A session's pages are where their addresses say, also after their process was killed."""

import os
import signal
import socket
from urllib.parse import urlsplit

from running_session import RunningSession, assert_sound, eventually


def connects(url):
    """Whether something listens where the address says."""
    where = urlsplit(url)
    with socket.socket() as tcp:
        return tcp.connect_ex((where.hostname, where.port)) == 0


def test_pages_are_where_the_addresses_say_also_after_a_kill(tmp_path):
    with RunningSession("taskboard", "--page", "8290", directory=tmp_path) as session:
        pages = session.pages()
        first = session.pids()["page_space"]
        printed = (tmp_path / "out.txt").read_text()
        assert pages["pages"] in printed
        assert f"token={pages['viewer_token']}" in printed
        os.kill(first, signal.SIGKILL)
        session.wait_for_flow()
        eventually(lambda: len(session.children()) == len(session.names), "the restart")
        assert connects(pages["space"]) and connects(pages["ground"])
        code, report = session.interrupt()
        assert not connects(pages["space"])
        session.assert_nothing_left()
    assert code == 0
    assert_sound(report)
    restarted = {name for name, entry in report["processes"].items() if entry["restarts"]}
    assert restarted == {"page_space"}
