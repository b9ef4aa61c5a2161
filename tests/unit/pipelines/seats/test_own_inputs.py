"""The cameras and microphones of pages."""

import json
import struct

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.seats.holders import Given, OwnInputs
from pipelines.seats.plan import seat_plan
from pipelines.session.access import Role
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Segment
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

PLAN = seat_plan(
    topology_of(BUILT_IN["spacejustin"], pages=True), Segment.SPACE, "x", built_in_dictionary()
)
CAMERA, MICROPHONE = PLAN.inputs


def picture(page_ms, index=CAMERA.index):
    width, height = CAMERA.size
    octets = bytes(width * height * 3 // 2)
    return struct.pack("<BBHHxxd", 0x83, index, width, height, page_ms) + octets


def sound(page_ms, sequence=1):
    return struct.pack("<BBHId", 0x84, MICROPHONE.index, 960, sequence, page_ms) + bytes(1920)


def ping(page_ms):
    return struct.pack("<B7xd", 0x81, page_ms)


def opened(*roles):
    inputs = OwnInputs(PLAN)
    for link, role in enumerate(roles):
        inputs.handle_opened(link, role)
    return inputs


def ask(inputs, link, name, *, on=True):
    text = json.dumps({"request": 1, "do": "input", "name": name, "on": on})
    return json.loads(inputs.handle_text(link, text, 0))["error"]


def test_an_input_belongs_to_one_page_until_it_is_given_back_or_gone():
    inputs = opened(Role.OPERATOR, Role.OPERATOR)
    assert ask(inputs, 0, "iss_camera") == ask(inputs, 0, "iss_camera") == ""
    assert ask(inputs, 1, "iss_camera") == "iss_camera: operator has it at another page"
    assert ask(inputs, 1, "iss_camera", on=False) == "iss_camera: this page does not have it"
    assert ask(inputs, 1, "iss_mic") == ""
    assert inputs.owners == {"iss_camera": 0, "iss_mic": 1}
    assert inputs.handle_message(1, picture(0.0), 0) is None
    assert ask(inputs, 0, "iss_camera", on=False) == ""
    assert ask(inputs, 1, "iss_camera") == ""
    inputs.handle_closed(1)
    assert inputs.owners == {"iss_camera": None, "iss_mic": None}


def test_only_inputs_of_this_seat_and_no_viewer():
    inputs = opened(Role.OPERATOR, Role.VIEWER)
    assert ask(inputs, 0, "head") == "head: no page can give this input here"
    assert ask(inputs, 1, "iss_camera") == "a viewer may watch only"
    assert inputs.handle_message(1, picture(0.0), 0) is None


def test_what_is_given_is_dated_by_the_ping_that_took_least_time():
    inputs = opened(Role.OPERATOR)
    ask(inputs, 0, "iss_camera")
    ask(inputs, 0, "iss_mic")

    def capture_ms(page_ms, now_ms):
        given = inputs.handle_message(0, picture(page_ms), now_ms * NS_PER_MS)
        assert isinstance(given, Given) and given.input is CAMERA
        return given.stamp.capture_ns / NS_PER_MS

    assert capture_ms(1e9, 1000) == 1000
    for page_ms, now_ms in ((100.0, 1150), (200.0, 1201), (300.0, 1390)):
        assert inputs.handle_message(0, ping(page_ms), now_ms * NS_PER_MS)[:1] == b"\5"
    assert capture_ms(390.0, 1400) == 1391
    assert capture_ms(500.0, 1400) == 1400
    assert capture_ms(-1e9, 1400) == 900
    given = inputs.handle_message(0, sound(390.0, 5), 1400 * NS_PER_MS)
    assert (given.input, given.stamp.sequence, len(given.data)) == (MICROPHONE, 5, 1920)


def test_too_much_or_garbage_closes_the_socket():
    inputs = opened(Role.OPERATOR)
    ask(inputs, 0, "iss_camera")
    with pytest.raises(ProtocolError):
        for _ in range(200):
            inputs.handle_message(0, picture(0.0), NS_PER_S)
    for text in ("{", '{"request": 1, "do": "session", "action": "stop"}'):
        with pytest.raises(ProtocolError):
            inputs.handle_text(0, text, 0)
    with pytest.raises(ProtocolError, match="unknown type"):
        inputs.handle_message(0, bytes(24), 0)
