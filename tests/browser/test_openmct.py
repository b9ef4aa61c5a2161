"""Open MCT, as the sample has it, shows a live session's values: those that YAMCS has."""

import contextlib
import shutil
import signal
import socket

import pytest
from janus_room import free_port
from positions import ROOT
from programs import needs, running
from running_session import RunningSession, eventually
from yamcs import Yamcs, milliseconds, new_instance, value_of

from pipelines.session.command_process import end_with_parent

PACKAGES = ROOT / ".ci" / "web" / "node_modules"
NEEDED = ("openmct/dist/openmct.js", "http-server/bin/http-server")
#: Rows of the table of one parameter: its texts.
ROWS = """
    return [...document.querySelectorAll(".c-telemetry-table__body tr")].map(
      (row) => [...row.querySelectorAll("td")].map((cell) => cell.textContent.trim()));
"""
PARAMETER, WHICH = "robot_x", "x"


@pytest.fixture
def served(tmp_path):
    """served(port): the address of the sample before YAMCS at that port, by its README."""
    needs("node")
    if not all((PACKAGES / one).exists() for one in NEEDED):
        pytest.skip("openmct: npm --prefix .ci/web install")
    site = tmp_path / "site"
    shutil.copytree(ROOT / "samples" / "openmct", site)
    (site / "node_modules").symlink_to(PACKAGES)

    with contextlib.ExitStack() as started:

        def start(port):
            own = free_port()
            words = ("-s", "-a", "127.0.0.1", "-p", own, "--proxy", f"http://127.0.0.1:{port}")
            command = ("node", PACKAGES / NEEDED[1], *words)
            how = {"end": signal.SIGTERM, "cwd": site, "preexec_fn": end_with_parent}
            started.enter_context(running(tmp_path / "http.txt", *command, **how))
            eventually(lambda: _answers(own), "the sample's server")
            return f"http://127.0.0.1:{own}"

        yield start


def test_open_mct_shows_the_values_of_yamcs_as_they_come(served, start_browser, tmp_path):
    packets, port, ground = free_port(), free_port(), tmp_path / "ground"
    options = ("--setup", "taskboard", "--packets", f"tcp:{packets}", "--http-port", port)
    new_instance(ground, *options)
    session = RunningSession("taskboard", "--packets", f"tcp:{packets}", directory=tmp_path)
    with session, Yamcs(ground, port) as yamcs, start_browser(size=(1280, 800)) as browser:
        eventually(yamcs.is_linked, "YAMCS' connection")
        # A value of before the page was there.
        yamcs.do("robot_get", which=WHICH)
        page = browser.open(f"{served(port)}/#/browse/yamcs:session/yamcs:{PARAMETER}?view=table")
        shown = eventually(lambda: page.run(ROWS), "a row")
        for _ in range(3):
            yamcs.do("robot_get", which=WHICH)
            before = len(shown)
            shown = eventually(lambda n=before: newer(page, n), "a new row")
        told = {
            milliseconds(row["generationTime"]): value_of(row["engValue"])
            for row in yamcs.all(
                f"archive/kontur_av/parameters/kontur_av/{PARAMETER}",
                "parameter",
                source="replay",
            )
        }
        for name, instant, value, unit in shown:
            assert (name, unit) == (PARAMETER, "m")
            # It shows five places.
            assert float(value) == pytest.approx(told[milliseconds(instant)], abs=1e-5)
        assert len(shown) == len({instant for _, instant, *_ in shown})
        browser.assert_no_errors()
        session.finish()


def _answers(port):
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


def newer(page, count):
    rows = page.run(ROWS)
    return rows if len(rows) > count else None
