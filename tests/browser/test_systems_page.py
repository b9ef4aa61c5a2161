"""The systems operator's page beside a live session, with `kontur-av maintain` and files."""

import json
from random import Random

from browser import eventually
from file_transfer import Transfer
from janus_room import free_port
from running_session import BOARD, RunningSession

from telepresence.upkeep.inbox import TOLD, UpdateInbox

SAYS = "document.querySelector('{}').innerText.toLowerCase().includes('{}')"


def test_the_systems_operator_sees_files_software_and_milestones_and_restarts_a_process(
    start_browser, tmp_path, monkeypatch
):
    status = tmp_path / "status.json"
    monkeypatch.setenv("KONTUR_AV_STATUS", str(status))
    ends = tmp_path / "ends"
    (ends / "ground").mkdir(parents=True)
    (ends / "ground" / "image.bin").write_bytes(Random(1).randbytes(16_000))
    joystick = ends / "space" / "joystick"
    joystick.mkdir(parents=True)
    (joystick / TOLD).write_bytes(UpdateInbox(("copy",)).told("sd/2", "run", {"sd/1": "valid"}))
    script = tmp_path / "night.txt"
    script.write_text("milestone the page is open\ntc robot ping\n")

    def busy():
        return json.loads(status.read_text())["busy"]

    options = ("--files", str(ends), "--tasks", "--trainer", "--page", str(free_port()))
    with RunningSession(BOARD, *options, directory=tmp_path) as session:
        session.wait_for_flow()
        page = start_browser().open(session.pages()["systems"])
        page.wait(SAYS.format("upkeep-panel", "none runs"))
        page.wait(SAYS.format("upkeep-panel", "fit together"))
        page.wait(SAYS.format("software-table", "joystick: sd/2 (backup)"))
        assert busy() is False

        eventually(lambda: session.ask("task", "select", "aiming").returncode == 0, "an experiment")
        page.wait(SAYS.format("upkeep-panel", "updates wait"))
        eventually(busy, "the keeper's program is busy")
        assert session.ask("maintain", str(script), "--yes").returncode == 1
        assert session.ask("task", "abort").returncode == 0

        # Meanwhile the experiment rests, which it must for 10 s.
        put = Transfer(session, "put", "image.bin")
        page.wait(SAYS.format("transfer-table", "put image.bin"))
        page.wait(SAYS.format("transfer-table", "running"))
        assert session.ask("trainer", "los", "8").returncode == 0
        page.wait(SAYS.format("transfer-table", "suspended"))
        page.wait(SAYS.format("transfer-table", "running"))

        page.run(
            "document.querySelector('process-control select').value = arguments[0]",
            "space_supervisor space_display",
        )
        page.find("[data-deed=restart]").click()
        page.wait(SAYS.format("process-control", "start space display: done"))

        page.run("document.querySelector('software-table input').value = 'joystick'")
        page.run("document.querySelector('software-table form').requestSubmit()")
        page.wait(SAYS.format("software-table", "it is fetched"))
        fetched = ends / "ground" / "fetched" / "joystick" / TOLD
        eventually(fetched.exists, "what runs in space")

        eventually(lambda: not busy(), "the end of the experiment")
        assert session.ask("maintain", str(script), "--yes").returncode == 0
        page.wait(SAYS.format("milestone-list", "the page is open"))
        assert put.end() == 0, put.said()
        page.wait(SAYS.format("transfer-table", "none is under way"))
        session.finish(sound=True)
