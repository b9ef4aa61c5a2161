"""What a page asks for in words."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from pipelines.seats.texts import (
    InputRequest,
    JoystickRequest,
    SessionRequest,
    parse_media_request,
    parse_seat_request,
)


def test_requests_of_a_seat():
    stop = parse_seat_request('{"request": 3, "do": "session", "action": "stop"}')
    assert stop == SessionRequest(request=3, action="stop")
    halt = parse_seat_request('{"request": 4, "do": "joystick", "event": "halt"}')
    assert halt == JoystickRequest(request=4, event="halt")
    on = parse_media_request('{"request": 5, "do": "input", "name": "iss_mic", "on": true}')
    assert on == InputRequest(request=5, name="iss_mic", on=True)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[" * 4000,
        '{"request": 1, "do": "session"}',
        '{"request": -1, "do": "command", "application": "a"}',
        '{"request": 1e400, "do": "command", "application": "a"}',
        '{"request": 1, "do": "command", "application": ""}',
        '{"request": 1, "do": "command", "application": "a", "more": 1}',
        '{"request": 1, "do": "joystick", "event": "fault"}',
        '{"request": 1, "do": "input", "name": "iss_mic", "on": true}',
        '{"request": 1, "do": "quit"}',
        '{"request": 1, "do": "command", "application": "\ud800"}',
    ],
)
def test_anything_else_is_refused(text):
    with pytest.raises(ProtocolError):
        parse_seat_request(text)


@given(
    st.text(max_size=100)
    | st.recursive(
        st.none() | st.integers() | st.text(max_size=9),
        lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(("request", "do")), inner),
        max_leaves=5,
    ).map(json.dumps)
)
def test_any_text_is_a_request_or_refused(text):
    for parse in (parse_seat_request, parse_media_request):
        try:
            parse(text)
        except ProtocolError:
            continue
