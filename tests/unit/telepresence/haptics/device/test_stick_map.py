"""A joystick map: which control of a device moves what, and one line for each mistake."""

import pytest
from gamepads import CONTROLLERS, settled
from msgspec.structs import astuple

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from pipelines.cli import main
from telepresence.haptics.axes import AxisName, AxisSettings
from telepresence.haptics.device.gamepad import read_stick_map
from telepresence.haptics.device.stick import Stick
from telepresence.haptics.device.stick_map import pad_controls

MAP = """
[axis.x]
control = "ABS_RX"
scale = -0.5
dead_zone = 0.2
[axis.z]
control = ["ABS_RZ", "ABS_Z"]
mode = "rate"
[axis.pan]
control = "ABS_HAT0X"
mode = "rate"
scale = 2.0
[buttons]
dead_man = "BTN_A"
stop = "BTN_EAST"
hand_over = "BTN_0x134"
panel = ["BTN_NORTH"]
"""


@pytest.fixture
def mapped(tmp_path):
    def read(text=MAP):
        path = tmp_path / "pad.toml"
        path.write_text(text)
        return read_stick_map(path)

    return read


def test_each_control_moves_what_the_file_says(mapped):
    axes, keys, _ = CONTROLLERS["pad"]
    more = ("z", AxisName("pan", AxisSettings(kind="rotary")))
    stick = Stick("pad", axes, keys, more=more, mapping=mapped())
    for code, value in ((0, 32767), (1, 32767), (3, 32767), (5, 255), (0x10, -1)):
        stick.handle_event(3, code, value)
    # y has no control. Half of the way is that of a dead zone's end at the scale, turned.
    assert settled(stick)[:2] == pytest.approx((-0.05, 0.0), abs=1e-4)
    stick.handle_event(3, 3, round(0.2 * 32767))
    assert settled(stick).x_m == pytest.approx(0.0, abs=1e-4)
    assert [one.position for one in stick.more_readings()] == [0.0, 0.0]
    for code in (0x130, 0x131, 0x134):
        stick.handle_event(1, code, 1)
    for _ in range(400):
        stick.advance(NS_PER_MS)
    z, pan = stick.more_readings()
    assert (z.position, pan.position) == pytest.approx((0.04, -0.8), abs=0.05)
    reading = stick.reading()
    assert (reading.dead_man, reading.stop, reading.hand_over, reading.buttons) == (1, 1, 1, 0)
    assert stick.mapped == [
        "x: ABS_RX, scale -0.5, dead zone 0.2, position",
        "z: ABS_RZ and ABS_Z, rate",
        "pan: ABS_HAT0X, scale 2, rate",
        *("dead-man: BTN_SOUTH", "stop: BTN_EAST", "hand-over: BTN_WEST", "button 1: BTN_NORTH"),
    ]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"ABS_RX"', '"ABS_QX"', "axis.x: 'ABS_QX' is no control: take a name"),
        ('"ABS_RX"', "3", "axis.x.control must be a control in quotes"),
        ('"ABS_RX"', '"ABS_HAT0X"', "ABS_HAT0X is used 2 times"),
        ('"ABS_RX"', '"BTN_TL"', "BTN_TL is a button: give two, up and down"),
        ("-0.5", "0.0", "axis.x: scale is 0: take up to 10"),
        ("0.2", "1.0", "axis.x: dead_zone is 1: take 0 to 0.9"),
        ('"rate"', '"speed"', "axis.z.mode must be one of position, rate, not 'speed'"),
        ("axis.pan", "axis.Pan", "axis 'Pan'"),
        ('"BTN_A"', '"ABS_X"', "buttons: ABS_X is no button"),
        ('"BTN_EAST"', '"BTN_A"', "BTN_SOUTH is used 2 times"),
        ('dead_man = "BTN_A"', "", "buttons needs dead_man"),
        ("scale", "scalle", "unknown field axis.x.scalle: the nearest one is axis.x.scale"),
    ],
)
def test_a_mistake_is_one_line(mapped, old, new, words):
    with pytest.raises(ConfigError, match=r"^joystick map .*pad.toml") as refused:
        mapped(MAP.replace(old, new, 1))
    assert words in str(refused.value) and "\n" not in str(refused.value)


def test_a_control_that_the_device_lacks_is_named_with_those_that_it_has(mapped):
    axes, keys, _ = CONTROLLERS["small pad"]
    with pytest.raises(ConfigError, match=r"axis\.x: there is no ABS_RX; it has ABS_X, ABS_Y, BTN"):
        Stick("small pad", axes, keys, mapping=mapped())


def test_a_page_gets_the_same_map_by_the_numbers_of_a_standard_gamepad(mapped):
    controls = pad_controls(mapped(), ("z", "gripper"))
    assert tuple(map(astuple, controls.axes)) == (
        ("x", 2, -1, -1, -0.5, 0.2, False),
        ("z", -1, 7, 6, 1.0, 0.0, True),
    )
    assert (controls.dead_man, controls.stop, controls.hand_over, controls.panel) == (
        (0,),
        1,
        2,
        (3,),
    )
    with pytest.raises(ConfigError, match="a browser's gamepad has no ABS_THROTTLE for x"):
        pad_controls(mapped(MAP.replace("ABS_RX", "ABS_THROTTLE")), ())


@pytest.mark.parametrize("words", [("check", "sim"), ("test", "--device", "sim")])
def test_the_commands_take_it_for_a_game_controller_only(mapped, tmp_path, words, capsys):
    mapped()
    assert main(["joystick", *words, "--joystick-map", str(tmp_path / "pad.toml")]) == 2
    assert "joystick sim: a joystick map is for evdev and page" in capsys.readouterr().err
