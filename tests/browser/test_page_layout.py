"""Each page on a telephone and on screens, dark and light: nothing is cut, and axe-core agrees.

No session runs: a worker or a socket in the page's place tells it what a server would.
"""

import functools
import http.server
import itertools
import json
import threading
from html import escape

import msgspec
import pytest
from positions import ROOT

from kontur_av.clock import NS_PER_S
from pipelines.mission.mission import listed_tasks
from pipelines.mission.tmtc_messages import Reported
from pipelines.seats.plan import seat_plan
from pipelines.seats.seat import Seat
from pipelines.seats.texts import SoftwareText, TransferText, UpkeepText, WelcomeText, pack_text
from pipelines.session.access import Role
from pipelines.session.mission_messages import (
    ExperimentShown,
    PanelShown,
    RobotStatus,
    RunShown,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.training import Exercises
from pipelines.session.web_site import page_text
from pipelines.study.plan import Aiming, HandleLevels, StudyPlan
from pipelines.study.trials import StudyPhase, StudyPress, StudyTrials
from pipelines.table import topology_of
from telepresence.haptics.device.page import PageDevice
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.plan import TaskWorld
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

STATIC = ROOT / "pipelines" / "seats" / "static"
AXE = ROOT / ".ci" / "web" / "node_modules" / "axe-core" / "axe.min.js"
WIDTHS = (390, 1280, 1920)
PAGES = {
    None: ("study",),
    Segment.SPACE: ("welcome", "space", "panel", "k2cp", "trainer"),
    Segment.GROUND: ("ground", "top", "k2sv", "systems"),
}
#: What a session's owner is told where people choose a page.
WELCOME = WelcomeText(
    trainer=True,
    role=Role.OPERATOR,
    seat=Segment.SPACE,
    ports={"space": 65_534, "ground": 65_535},
    tasks=True,
    people={role.value: "t" * 32 for role in Role if role is not Role.OPERATOR},
)
#: In the place of the page's worker or socket: what it is given comes as the server's texts.
WORKER = """
    window.WebSocket = class {
      constructor() { window.socket = this; }
      send() {}
    };
    window.Worker = class {
      constructor() { window.worker = this; }
      postMessage() {}
      tell(data) { this.onmessage({ data }); }
    };
"""
TELL_STUDY = "for (const data of arguments[0]) socket.onmessage({ data })"
TELL = """
    window.worker?.tell({ kind: "heard" });
    for (const text of arguments[0]) worker.tell({ kind: "text", text: JSON.parse(text) });
"""
#: Each text that a box cuts. Wide tables of figures scroll within their tab.
CUT = """
    const found = [];
    const root = document.documentElement;
    if (root.scrollWidth > root.clientWidth) found.push("the page scrolls sideways");
    for (const element of document.querySelectorAll("body *")) {
      if (!element.checkVisibility() || element.closest(".only-spoken")) continue;
      const texts = [...element.childNodes].filter((one) => one.nodeType === Node.TEXT_NODE);
      if (!texts.some(({ data }) => data.trim() !== "")) continue;
      const range = document.createRange();
      range.selectNodeContents(element);
      const { left, right } = range.getBoundingClientRect();
      for (let box = element; box !== document.body; box = box.parentElement) {
        const { overflowX, contain } = getComputedStyle(box);
        if (overflowX === "auto" && box.matches("[role=tabpanel]")) break;
        if (overflowX === "visible" && !/paint|strict|content/.test(contain)) continue;
        const edge = box.getBoundingClientRect();
        if (left >= edge.left - 1 && right <= edge.right + 1) continue;
        found.push(`${box.localName} cuts ${element.localName}: ${element.textContent}`);
        break;
      }
    }
    return found;
"""
SERIOUS = """
    // The new theme begins with the next frame.
    const frame = () => new Promise(requestAnimationFrame);
    await frame().then(frame);
    // Colours fade into those of another theme.
    const fades = document.getAnimations().filter((one) => one.effect.getTiming().iterations < 9);
    await Promise.all(fades.map(({ finished }) => finished));
    const { violations } = await axe.run(document, { resultTypes: ["violations"] });
    return violations
      .filter(({ impact }) => ["serious", "critical"].includes(impact))
      .map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html).join(" ")}`);
"""
#: What of these is not wholly in the window.
HIDDEN = """
    const inside = ({ top, bottom }) => top >= -1 && bottom <= innerHeight + 1;
    return [...document.querySelectorAll(arguments[0])]
      .filter((one) => one.checkVisibility() && !inside(one.getBoundingClientRect()))
      .map(({ localName, id }) => `${localName} ${id}`);
"""
TABS = "return [...document.querySelectorAll('[role=tab]')].map(({ id }) => id)"
REASON = "the robot has a fault: a drive reports a fault"
STUDY = StudyPlan(
    name="handle",
    consent="I take part of my own will. I may stop whenever I like, and nobody asks me why.",
    participants=2,
    handle=HandleLevels(damping_n_s_m=(0.0, 8.0)),
    aiming=(Aiming(name="still"),),
    trials=2,
)


TRANSFER = TransferText(
    end="ground",
    number=4_294_967_295,
    what="get",
    state="suspended",
    octets=12_345_678,
    size=16_777_216,
    rate_bps=198_765,
    name="joystick/a-rather-long-name-of-a-log-2026-11-27T17:00:00Z.txt",
)
UPKEEP = UpkeepText(
    files=True,
    transfers=(TRANSFER,),
    software=(
        SoftwareText(
            end="space",
            inbox="joystick",
            written="2026-11-27 17:00:00",
            runs="sd/2",
            why="run",
            states={"sd/1": "its list of checksums is damaged", "sd/2": "valid"},
            waiting=("a-rather-long-name-of-an-archive.tar.gz",),
            busy=True,
            answers=("broken.tar.gz: refused, no sound archive: its end is missing",),
        ),
    ),
)


def metrics_of(*, connected):
    """What the launcher tells a page of contact, bandwidth, processes and events."""
    supervised = {
        "state": "connected" if connected else "refused",
        "why": "the peer speaks version 2 of the link, this end 1",
    }
    metrics = {
        f"gateways.{end}.supervision.{key}": value
        for end in ("ground", "space")
        for key, value in supervised.items()
    }
    path = {"state": "fewer pictures", "bps": 812_000, "why": "records wait 1234 ms, and " * 2}
    metrics |= {f"gateways.space.peer.path_{key}": value for key, value in path.items()}
    metrics |= {
        "contact.since_acquisition_s": 101.0,
        "contact.until_loss_s": 492.0,
        "contact.ahead": "end of shadowing of the downlink",
        "contact.ahead_s": 42.5,
        "upkeep.experiment": "follow_contour, run 12",
        "upkeep.short": "downlink video, uplink voice",
    }
    text = "maintain: file put joystick/a-rather-long-name-of-an-archive.tar.gz: done"
    events = [
        {"number": number, "at_us": number, "what": what, "text": text}
        for number, what in enumerate(("milestone", "upkeep"), 1)
    ]
    told = {"at_us": 100_000_000, "seconds": 100.0, "state": "running", "events": events}
    return {"kind": "figures", "figures": metrics, "link": {}, "processes": [], **told}


def texts_of_study(*, begun):
    """What the page of a study is told on its first screen, and where a trial begins."""
    service = StudyTrials(STUDY, PageDevice(start_m=(0.0, 0.0)), {})
    for now_ns in range(0, 10 * NS_PER_S, NS_PER_S):
        service.handle_time(now_ns)
        if begun and service.phase is not StudyPhase.START:
            service.handle_press(StudyPress(service.show(now_ns).screen), now_ns)
    told = [service.show(now_ns), *([] if service.frame is None else [service.frame])]
    assert (told[0].phase is StudyPhase.START) is begun
    return [msgspec.json.encode(one).decode() for one in told]


def texts_of(segment, *, connected):
    """What a page is told in the middle of a session with tasks, with the longest words."""
    catalogue = built_in_tasks()
    topology = topology_of(BUILT_IN["spacejustin"], pages=True, tasks=True, trainer=True)
    listed = listed_tasks(catalogue, TaskWorld())
    plan = seat_plan(topology, segment, "x", built_in_dictionary(), tasks=listed)
    seat = Seat(plan, first_command=1)
    if segment is Segment.GROUND:
        runs = (RunShown("handshake", 12, "aborted", REASON, 12.5),)
        task = {"phase": "running", "task": "handshake", "run": 13, "elemop": "followContour"}
        experiment = ExperimentShown(**task, panel="press_deadman", tasks=listed, runs=runs)
        seat.handle_shown("experiment", experiment)
        place = {"x_m": -0.1, "y_m": 0.1, "push_n": 12.3, "hold": "the robot was off"}
        mode = ControlMode.TELEPRESENCE
        robot = RobotStatus(
            boot_id=1, powered=False, mode=mode, fault=REASON, waiting=True, **place
        )
        seat.handle_shown("robot", robot)
        seat.handle_shown("upkeep", UPKEEP)
    else:
        words = "Well held. Now let go of the mouse button, your finger, Space or the trigger."
        panel = PanelShown(
            mode="running" if connected else "hold",
            task="contour",
            run=12,
            text=words,
            words=words,
            start_m=(0.0, 0.0),
            held_s=0.3,
            hold_s=0.5,
            left_s=60.0,
            goal="reach",
            target_m=(-0.045, 0.0),
            step=2,
            steps=4,
        )
        seat.handle_shown("panel", panel)
    said = {"state": "recoverable error", "application": "german experiment", "test": "running"}
    report = Reported("housekeeping", "joystick", unix_ns=0, values={**said, "temperature": 60.125})
    seat.handle_news(report, 0)
    lost = {"left": 3600 * NS_PER_S}
    seat.handle_shown("exercises", Exercises(los_ns=20 * NS_PER_S, cameras_ns=lost))
    page = seat.handle_opened(Role.OPERATOR, 0)
    found = []
    while (message := seat.poll_transmit(page)) is not None:
        found.append(message)
    told = [json.loads(text) for text in found if isinstance(text, str)]
    link = "connected" if connected else "lost"
    return [text | {"link": link} if text["kind"] == "state" else text for text in told]


@pytest.fixture(scope="module")
def address():
    class Handler(http.server.SimpleHTTPRequestHandler):
        def do_GET(self):
            name = self.path.strip("/")
            if not (STATIC / f"{name}.html").exists():
                super().do_GET()
                return
            text = page_text(STATIC / f"{name}.html").replace("__BASE__", "/")
            text = text.replace("__WELCOME__", escape(pack_text(WELCOME)))
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, *_):
            pass

    handler = functools.partial(Handler, directory=STATIC)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture
def told(browser, address):
    """told(name, texts): a page that was told these texts."""

    def open_page(name, texts=()):
        page = browser.open("about:blank")
        page.load(f"{address}{name}", WORKER)
        page.run(TELL, [json.dumps(text) for text in texts])
        return page

    return open_page


@pytest.mark.parametrize(
    ("segment", "name"), [(segment, name) for segment, names in PAGES.items() for name in names]
)
def test_no_page_scrolls_sideways_cuts_a_text_or_shuts_people_out(segment, name, told, browser):
    page = told(name)
    found = {}
    for width, connected in itertools.product(WIDTHS, (False, True)):
        if name == "study":
            page.run(TELL_STUDY, texts_of_study(begun=connected))
        elif name != "welcome":
            texts = texts_of(segment, connected=connected)
            texts += [metrics_of(connected=connected)] if name in ("space", "systems") else []
            page.run(TELL, [json.dumps(text) for text in texts])
        page.fit(width)
        for tab in page.run(TABS) or [""]:
            if tab:
                page.run("document.getElementById(arguments[0]).click()", tab)
            found[width, connected, tab] = page.run(CUT)
    if name in ("panel", "space"):
        page.wait("!document.querySelector('task-widget').hidden", "the task over the picture")
    assert {what: wrong for what, wrong in found.items() if wrong} == {}
    if not AXE.exists():
        pytest.skip("axe-core: npm --prefix .ci/web install")
    page.run(AXE.read_text())
    for theme in ("dark", "light"):
        scheme = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", scheme)
        assert (theme, page.run(SERIOUS)) == (theme, [])


def test_a_task_that_cannot_be_done_here_says_so_and_cannot_be_selected(told):
    texts = texts_of(Segment.GROUND, connected=True)
    idle = {"phase": "idle", "task": ""}
    page = told("top", [text | idle if text["kind"] == "experiment" else text for text in texts])
    shown = {
        button.get_attribute("data-task"): (button.is_enabled(), "needs two hands" in item.text)
        for button, item in (
            (item.find_element("css selector", "[data-task]"), item)
            for item in page.driver().find_elements("css selector", ".tasks li")
        )
    }
    two_handed = {"handshake", "ball"}
    assert shown.keys() > two_handed
    assert all(of == (name not in two_handed, name in two_handed) for name, of in shown.items())


def test_a_parameter_that_only_functions_are_given_has_no_row(told):
    page = told("k2sv", texts_of(Segment.GROUND, connected=True))
    rows = page.driver().find_elements("css selector", "tr[data-parameter]")
    # Those of other tabs are not displayed either.
    shown = {row.get_attribute("data-parameter") for row in rows if not row.get_property("hidden")}
    assert "joystick.state" in shown
    assert not {"ground_supervisor.process", "space_supervisor.process", "tasks.task"} & shown


def test_parameters_that_never_came_are_one_row_until_a_person_opens_it(told):
    page = told("k2cp", texts_of(Segment.SPACE, connected=True))
    rows = (
        "[...document.querySelectorAll('tr[data-parameter]')].filter((row) => !row.hidden).length"
    )
    few = page.run(f"return {rows}")
    fold = page.find(".fold")
    (count,) = [int(word) for word in fold.text.split() if word.isdigit()]
    fold.click()
    assert page.run(f"return {rows}") == few + count > few > 0


def test_a_low_screen_shows_contact_ages_and_stop_without_a_scroll(told):
    for name, segment, shown in (
        ("space", Segment.SPACE, "contact-panel, senses-panel, joystick-panel, hand-panel"),
        ("ground", Segment.GROUND, "contact-band, figure, tab-group"),
    ):
        page = told(name, [*texts_of(segment, connected=True), metrics_of(connected=True)])
        for height in (720, 800, 900):
            page.fit(1280, height)
            hidden = page.run(HIDDEN, f"button.emergency, #show-keys, {shown}")
            assert (name, height, hidden) == (name, height, [])


def test_what_leads_on_at_the_robot_is_a_button_where_it_is_advised(told):
    texts = texts_of(Segment.GROUND, connected=True)
    for next_step, why, words in (
        ("power on", "robot off", "Power on"),
        ("power off, set mode", "robot mode", "Power off"),
        ("power off, set mode", "robot off", "Set mode telepresence"),
        ("wait", "robot off", ""),
    ):
        state = next(text for text in texts if text["kind"] == "state")
        state["situation"] |= {"next": next_step, "why": why}
        page = told("ground", texts)
        assert page.find("[data-stop=robot]").text == words


def test_no_page_says_that_a_server_is_silent_which_is_heard_again(told):
    page = told("top", texts_of(Segment.GROUND, connected=True))
    silent = "document.querySelector('radio-banner').innerText.includes('does not answer')"
    for note, says in (
        ({"kind": "lost", "why": "silent", "reason": ""}, True),
        ({"kind": "heard"}, False),
    ):
        page.run("worker.tell(arguments[0])", note)
        page.wait(f"{silent} === {json.dumps(says)}")
