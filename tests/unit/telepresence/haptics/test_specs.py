"""Specifications: how a command line names a joystick or a robot, and what it cannot name."""

import sys
from dataclasses import replace

import pytest
from positions import ROOT

from kontur_av.errors import ConfigError
from telepresence.haptics.device.simulated import Faults
from telepresence.haptics.hand import Hand
from telepresence.haptics.specs import (
    capabilities_of,
    check_joystick,
    is_simulated,
    open_alone,
    open_device,
    open_robot,
)


def test_what_a_specification_opens():
    assert is_simulated("sim") and is_simulated("sim:weak") and not is_simulated("evdev")
    with pytest.raises(ConfigError, match=r"the faults are stuck-x, .*unplugged"):
        open_device("sim:rust")
    for spec in ("page", "ros2"):
        with pytest.raises(ConfigError, match=f"--joystick {spec}"):
            open_alone(spec)
    hand = Hand()
    assert open_alone("sim:weak", hand=hand).hand is hand
    assert [one.name for one in open_alone("sim", axes=("z",)).capabilities.more] == ["z"]
    check_joystick("sim", ("z",))
    with pytest.raises(ConfigError):
        check_joystick("tests.helpers.user_parts:Nothing")
    assert replace(Faults()) == Faults(stuck=-1, friction=1.0, motor_gain=1.0, heat_c=0.0)


def test_a_robot_is_named_by_module_and_class(monkeypatch):
    monkeypatch.chdir(ROOT / "samples")
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert open_robot("own_robot:Mass").capabilities.name == "a mass before a wall"
    assert capabilities_of("own_robot:Mass").force_limit_n == 25.0


def test_a_driver_may_call_its_capabilities_facts_for_one_release(monkeypatch, tmp_path):
    (tmp_path / "former_arm.py").write_text(
        "from telepresence import RobotFacts\n\nclass Arm:\n    facts = RobotFacts(name='former')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.warns(FutureWarning, match="Arm.facts is called capabilities now"):
        assert capabilities_of("former_arm:Arm").name == "former"


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("nothing_here:Arm", "no module 'nothing_here'"),
        ("math:Arm", "has no class 'Arm'"),
        ("math:sqrt", "cannot be made: TypeError"),
        ("arm", "module:Class"),
    ],
)
def test_a_robot_or_joystick_that_is_not_there_is_one_line(spec, words):
    for opened in (capabilities_of, open_device):
        with pytest.raises(ConfigError, match=words) as refused:
            opened(spec)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("spec", ["", "usb", "sim:tired"])
def test_an_invalid_joystick_is_refused_in_one_line(spec):
    with pytest.raises(ConfigError, match="joystick"):
        check_joystick(spec)
