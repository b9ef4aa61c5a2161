"""Tasks in XML: the mission's own operations, and mistakes with line, name and fix."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.tasks.definitions import Reach
from telepresence.tasks.reader import MAX_FILE_OCTETS, read_tasks
from telepresence.tasks.task_files import built_in_tasks, load_tasks

START = """<SetPower name="off" on="false"/><SetPower name="on" on="true"/>
<SetMode name="position" mode="position"/><MoveTo name="home" x_mm="1" y_mm="2"/>
<Operation name="startX"><Elemop ref="position"/><Elemop ref="on"/><Elemop ref="home"/></Operation>
<Operation name="execX"><Elemop ref="on"/><Elemop ref="off"/></Operation>
"""
TASK = '<Task name="x" start="startX" exec="execX" start_x_mm="1" start_y_mm="2" text="Do x."/>'


def names(operation):
    return " ".join(elemop.name for elemop in operation.elemops)


def test_the_aiming_operations_are_those_of_the_mission():
    task = built_in_tasks().task("aiming")
    assert names(task.start) == (
        "powerOff positionControl powerOn selectCamTcp highlightLed0 homePosition startLogging"
    )
    assert names(task.exec) == (
        "powerOff telePresenceControl powerOn highlightLed7 checkPos7 highlightLed0 checkPos0 "
        "highlightLed5 checkPos5 highlightLed0 checkPos0 stopLogging powerOff"
    )
    assert task.exec.elemops[4] == Reach(name="checkPos7", led=7, within_mm=5.0, hold_s=0.5)
    assert task.cameras == ("stereo",)
    tasks = "aiming pursuit contour line spring free handshake ball"
    assert " ".join(built_in_tasks().tasks) == tasks


def test_a_users_file_adds_to_the_catalogue(tmp_path):
    path = tmp_path / "mine.xml"
    text = """<Tasks><Reach name="nearLed3" led="3" within_mm="2.5" timeout_s="9"/>
<Operation name="execMine"><Operation ref="beginTelepresence"/><Elemop ref="highlightLed3"/>
<Elemop ref="nearLed3"/><Operation ref="endTelepresence"/></Operation>
<Task name="mine" start="startAiming" exec="execMine" start_x_mm="-45" start_y_mm="0" text="Go."/>
</Tasks>"""
    path.write_text(text)
    task = load_tasks([path]).task("mine")
    assert names(task.exec) == (
        "powerOff telePresenceControl powerOn highlightLed3 nearLed3 stopLogging powerOff"
    )
    path.write_text(text.replace("nearLed3", "checkPos3"))
    with pytest.raises(ConfigError, match=r"mine\.xml, line 1: .*checkPos3.* is taken"):
        load_tasks([path])


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('\n<Reach name="a" led="8"/>', "line 2: <Reach name=\"a\">: led is '8': give a whole"),
        ('<Reach name="a" led="1" holds="1"/>', "unknown attribute holds: the nearest one is hold"),
        ('<Reach name="a"/>', 'line 1: <Reach name="a"> needs led'),
        ('<Rech name="a" led="1"/>', "unknown element <Rech>: the nearest one is <Reach>"),
        ('<Wait name="a" seconds="nan"/>', "seconds is 'nan': give a number from 0 to 600"),
        ('<SetMode name="a" mode="fast"/>', "choose one of position, torque, telepresence"),
        ('<SetPower name="a" on="yes"/>', "on is 'yes': give true or false"),
        ('<Show name="a"/>', 'give leds="0", or another pattern'),
        ('<Show name="1a" leds="0"/>', "up to 32 letters and digits"),
        ('<Wait name="a" seconds="1"/><Wait name="a" seconds="1"/>', "this name is taken"),
        ('<Operation name="a"/>', 'line 1: <Operation name="a"> needs an <Elemop>'),
        ('<Operation name="a"><Elemop ref="b"/></Operation>', "it is not defined above"),
        ('<Operation name="a"><Wait name="b" seconds="1"/></Operation>', "refer to it with"),
        ("<Wait name='a' seconds='1'><Wait/></Wait>", "<Wait> cannot be inside of <Wait>"),
        ("words", "line 1: text 'words': all values are attributes"),
        (START + TASK + TASK, 'line 5: <Task name="x">: this name is taken'),
        (START + TASK.replace("startX", "strtX"), "not defined above: the nearest one is startX"),
        (START + TASK.replace('"2"', '"3"'), "startX must move the tip to start_x_mm"),
        (START + TASK.replace('exec="execX"', 'exec="startX"'), "startX leaves the robot on"),
        (START + TASK.replace("Do x.", "y" * 129), "text has 129 octets"),
    ],
)
def test_a_mistake_is_told_with_line_name_and_mend(inside, message):
    with pytest.raises(ConfigError) as caught:
        read_tasks(f"<Tasks>{inside}</Tasks>".encode())
    assert message in str(caught.value)


def test_nothing_outside_of_the_file_is_read(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("secret")
    for document in (
        f'<!DOCTYPE Tasks [<!ENTITY e SYSTEM "{secret}">]><Tasks>&e;</Tasks>',
        '<!DOCTYPE Tasks [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><Tasks>&b;</Tasks>',
        f'<!DOCTYPE Tasks SYSTEM "{secret}"><Tasks/>',
    ):
        with pytest.raises(ConfigError, match="line 1: a document type is not allowed"):
            read_tasks(document.encode())


def test_what_is_no_file_of_tasks_is_refused():
    for octets, message in (
        (b"", "no well-formed XML"),
        (b"<Tasks>", "no well-formed XML"),
        (b"<Other/>", "the outermost element is <Tasks>"),
        (b"<?xml version='1.0' encoding='none'?><Tasks/>", "unknown encoding"),
        (b" " * (MAX_FILE_OCTETS + 1), "at most"),
    ):
        with pytest.raises(ConfigError, match=message):
            read_tasks(octets)
