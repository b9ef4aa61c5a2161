"""What the joystick's log says, by the states that it is handed."""

from msgspec.structs import replace

from pipelines.files.joystick_log import JoystickLog, log_name
from pipelines.hand.hand_topics import JoystickStatus
from telepresence.haptics.device.states import JoystickState

S = 1_000_000_000
AT_NS = 1_800_000_000 * S


def test_each_change_is_one_line_and_a_state_that_is_told_again_is_none():
    log = JoystickLog()
    first = JoystickStatus(
        state=JoystickState.STANDBY,
        reason="",
        dead_man=False,
        force_limit_n=15.0,
        device="simulated",
        half_width_m=0.1,
        half_height_m=0.1,
        temperature_c=30.0,
    )
    assert log.handle_status(first, AT_NS) == [
        "2027-01-15T08:00:00.000Z begins: simulated, workspace 20 x 20 cm, force limit 15 N\n",
        "2027-01-15T08:00:00.000Z standby\n",
        "2027-01-15T08:00:00.000Z motors at 30.0 °C\n",
    ]
    assert log.handle_status(replace(first, x_m=0.01, temperature_c=31.0), AT_NS + S) == []
    hot = replace(
        first,
        state=JoystickState.HALTED,
        reason="too hot",
        dead_man=True,
        commanded=7,
        command_refusal="calibrate it first",
        test="passed",
        test_number=1,
        test_metrics={"stiffness_x": 801.25, "rest_x": None},
    )
    found = [line[25:].rstrip() for line in log.handle_status(hot, AT_NS + 2 * S)]
    assert found == [
        "halted: too hot",
        "dead-man button pressed",
        "functional test passed: stiffness_x 801.2",
        "a telecommand was refused: calibrate it first",
    ]
    assert log_name(AT_NS) == "joystick-2027-01-15T080000Z.txt"
