"""The joystick's states: only transitions of the table, and none out of a fatal error."""

from hypothesis import given
from hypothesis import strategies as st

from telepresence.haptics.device.states import (
    TRANSITIONS,
    JoystickEvent,
    JoystickState,
    StateMachine,
)


@given(st.lists(st.sampled_from(JoystickEvent), max_size=60))
def test_no_sequence_of_events_leaves_the_table(events):
    machine, fatal = StateMachine(), False
    for number, event in enumerate(events):
        before = machine.state
        refusal = machine.handle_event(event, number)
        if (before, event) in TRANSITIONS:
            assert not refusal
            assert machine.state is TRANSITIONS[before, event]
            assert machine.since_ns == number
        else:
            assert machine.state is before
            assert event.value in refusal
            assert refusal.count("\n") == 0
        fatal = fatal or machine.state is JoystickState.FATAL
        assert not fatal or machine.state is JoystickState.FATAL
    assert machine.entered + machine.refused == len(events)


def test_force_only_after_a_calibration_and_a_request():
    # All transitions into the application, followed back to their start.
    def before(state):
        return {first for (first, _), after in TRANSITIONS.items() if after is state}

    assert before(JoystickState.APPLICATION) == {JoystickState.CALIBRATED}
    ways = {way for way, after in TRANSITIONS.items() if after is JoystickState.CALIBRATED}
    assert ways - {(JoystickState.CALIBRATED, event) for event in JoystickEvent} == {
        (JoystickState.STANDBY, JoystickEvent.CALIBRATION_PASSED),
        (JoystickState.APPLICATION, JoystickEvent.STOP),
        (JoystickState.HALTED, JoystickEvent.RESUME),
    }
    # The halted state is reached only from calibrated states.
    assert before(JoystickState.HALTED) == {JoystickState.CALIBRATED, JoystickState.APPLICATION}


def test_a_refusal_says_what_is_allowed():
    machine = StateMachine()
    machine.handle_event(JoystickEvent.SELF_TEST_PASSED, 1)
    assert machine.handle_event(JoystickEvent.START, 2) == (
        "start: not in the state standby; allowed there: calibrate"
    )
    machine.handle_event(JoystickEvent.FATAL_FAULT, 3, "smoke")
    assert "smoke" in machine.handle_event(JoystickEvent.ACKNOWLEDGE, 4)
    assert machine.next_event().event is JoystickEvent.SELF_TEST_PASSED
    assert machine.next_event().reason == "smoke"
    assert machine.next_event() is None
