"""K2ACI: octets written out by hand after RFC 8949; once and in order over a path that loses."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pus_ends import FATES, MS, LossyPath, events, sent

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc import k2aci
from telepresence.tmtc.k2aci import Acknowledgement, Arrived, Delivered, Numbered, pack_body

MOST = (1 << 32) - 1
START = k2aci.StartTask(task="a", run=1)
ABORTED = k2aci.TaskFinished(task="a", run=1, result=k2aci.TaskResult.ABORTED, duration_ms=1000)
REACH = k2aci.TaskProgress(
    run=1,
    goal=k2aci.TaskGoal.REACH,
    step=2,
    steps=4,
    position_um=(-45_000, 0),
    hold_ms=500,
    held_ms=1,
    left_ms=60_000,
)
GOLDEN = {
    # [1, 258, 7, 5, "aiming", 3, [-1, 24], ""]
    "88 01 190102 07 05 6661696d696e67 03 8220 1818 60": Numbered(
        258, 7, 5, k2aci.TaskSelected(task="aiming", run=3, start_um=(-1, 24))
    ),
    "86 02 00 00 00 6161 01": Numbered(0, 0, 0, START),
    "89 03 00 00 00 6161 01 67 61626f72746564 1903e8 60": Numbered(0, 0, 0, ABORTED),
    "88 04 00 00 00 64 686f6c64 60 00 60": Numbered(
        0, 0, 0, k2aci.PanelState(mode=k2aci.PanelMode.HOLD)
    ),
    "86 05 1affffffff 09 09 69 63 6f736d6f6e617574 62 c3bc": Numbered(
        MOST, 9, 9, k2aci.Chat(sender=k2aci.ChatRole.COSMONAUT, text="ü")
    ),
    # [6, 0, 0, 0, 1, "reach", 2, 4, [-45000, 0], 0, 0, 0, 500, 1, 60000]
    "8f 06 00 00 00 01 65 7265616368 02 04 82 39afc7 00 00 00 00 1901f4 01 19ea60": Numbered(
        0, 0, 0, REACH
    ),
    "83 00 190102 07": Acknowledgement(258, 7),
}


def chat(text, sender=k2aci.ChatRole.SUPERVISOR):
    return k2aci.Chat(sender=sender, text=text)


def end(boot_id=1, **settings):
    return k2aci.K2aciEndpoint(boot_id=boot_id, **settings)


def numbered(number, oldest=0, boot_id=1):
    return pack_body(Numbered(boot_id, number, oldest, chat(str(number))))


def numbers(endpoint):
    return [event.number for event in events(endpoint)]


def bodies(endpoint, now_ns=0):
    return [k2aci.parse_body(octets) for octets in sent(endpoint, now_ns)]


@pytest.mark.parametrize(("octets", "body"), GOLDEN.items())
def test_bodies_have_these_octets(octets, body):
    assert pack_body(body) == bytes.fromhex(octets)
    assert k2aci.parse_body(bytes.fromhex(octets)) == body


def test_the_longest_message_fits():
    line = chat("x" * 200, k2aci.ChatRole.EXPERIMENTER)
    far = (-1_000_000, 1_000_000)
    task = k2aci.TaskSelected(task="t" * 32, run=MOST, start_um=far, text="x" * 128)
    octets = [pack_body(Numbered(MOST, MOST, MOST, message)) for message in (line, task)]
    assert max(map(len, octets)) == k2aci.MAX_BODY_OCTETS
    assert [k2aci.parse_body(one).message for one in octets] == [line, task]
    assert k2aci.MAX_BODY_OCTETS == 232
    for wrong in (b"", bytes(233)):
        with pytest.raises(ProtocolError, match="not 1 to 232"):
            k2aci.parse_body(wrong)


@pytest.mark.parametrize(
    "octets",
    [
        "80",
        "00",
        "83 00 190102",  # ends too soon
        "83 00 190102 07 00",  # octets after the end
        "83 00 1801 07",  # an integer that is not in its shortest form
        "83 00 c249000000000000000001 07",  # a big number
        "83 00 fb3ff0000000000000 07",  # floating point
        "83 00 20 07",  # a negative life
        "9f 00 01 07 ff",  # an array without its length
        "84 00 01 07 07",
        "86 07 00 00 00 6161 01",  # an unknown kind
        "8f 06 00 00 00 01 65 6569676874 01 01 820000 00 00 00 00 00 00",  # a spot without a turn
        "86 f5 00 00 00 6161 01",  # true instead of a kind
        "86 02 00 00 01 6161 01",  # the oldest above the number
        "86 02 00 00 00 60 01",  # no name
        "86 02 00 00 00 61 0a 01",  # a line feed
        "86 02 00 00 00 61 ff 01",  # no UTF-8
        "88 04 00 00 00 64 686f6c65 60 00 60",  # an unknown state
        "88 01 00 00 00 6161 03 83202020 60",
        "d8 23 61 28",  # a tag: the regular expression "("
        "86 02 00 00 00 5b00ffffffffffffff 01",  # 2^56 octets announced
    ],
)
def test_other_octets_are_refused(octets):
    with pytest.raises(ProtocolError, match="K2ACI: "):
        k2aci.parse_body(bytes.fromhex(octets))
    endpoint = end()
    endpoint.handle_message(bytes.fromhex(octets), 0)
    assert endpoint.garbage == 1


@pytest.mark.parametrize(
    ("kind", "fields", "line"),
    [
        (k2aci.Chat, {"sender": k2aci.ChatRole.COSMONAUT, "text": "x" * 201}, "has 201 octets: "),
        (k2aci.StartTask, {"task": "t" * 33}, "task has 33 octets: give 1 to 32"),
        (k2aci.StartTask, {"task": "a\nb"}, "one line of printable text"),
        (k2aci.StartTask, {"task": 5}, "one line of printable text"),
        (k2aci.StartTask, {"run": -1}, "run is -1"),
        (k2aci.StartTask, {"run": 1 << 32}, "run is 4294967296"),
        (k2aci.StartTask, {"run": True}, "run is True"),
        (k2aci.TaskFinished, {"result": "done"}, "choose one of finished, aborted"),
        (k2aci.TaskSelected, {"start_um": (1, 2, 3)}, "give two integers"),
        (k2aci.TaskSelected, {"start_um": [1, 2]}, "give two integers"),
        (k2aci.TaskSelected, {"start_um": (1_000_001, 0)}, "up to ±1000000"),
        (k2aci.TaskSelected, {"start_um": (0, -1_000_001)}, "up to ±1000000"),
        (k2aci.TaskSelected, {"start_um": (0, 0.5)}, "up to ±1000000"),
        (k2aci.TaskProgress, {"goal": k2aci.TaskGoal.CIRCLE}, "a spot needs the time of a turn"),
        (
            Numbered,
            {"boot_id": 0, "number": 1, "oldest": 2, "message": START},
            "2 is above the num",
        ),
        (k2aci.K2aciEndpoint, {"boot_id": -1}, "boot_id is -1"),
        (k2aci.K2aciEndpoint, {"boot_id": 0, "timeout_ns": 0}, "timeout above 0"),
    ],
)
def test_unfit_fields_are_refused_with_what_fits(kind, fields, line):
    known = {"task": "a", "run": 1}
    names = getattr(kind, "__dataclass_fields__", ())
    with pytest.raises(ConfigError, match=line):
        kind(**{name: value for name, value in known.items() if name in names} | fields)


def test_a_line_is_cut_to_whole_characters():
    assert k2aci.fitted_line("a\nb") == "a b"
    assert k2aci.fitted_line("x" + "ü" * 64) == "x" + "ü" * 63
    assert k2aci.fitted_line("ü" * 64) == "ü" * 64


def test_waiting_messages_and_answers_are_bounded():
    space, ground = end(), end()
    assert [space.send(chat("x"), 0) for _ in range(65)] == [*range(64), None]
    packets = sent(space)
    assert len(packets) == 4
    for octets in packets * 10:
        ground.handle_message(octets, 0)
    assert len(sent(ground)) == 16
    assert ground.dropped_answers == 24


def test_what_comes_too_early_waits_for_what_the_sender_still_repeats():
    ground = end()
    for number in (1, 2, 2, 0):
        ground.handle_message(numbered(number), 0)
    assert (numbers(ground), ground.arrived, ground.duplicates) == ([0, 1, 2], 3, 1)
    # The sender repeats nothing below 5 any more: 3 will not come, and 4 is not handed out.
    ground.handle_message(numbered(4), 0)
    ground.handle_message(numbered(6, oldest=5), 0)
    ground.handle_message(numbered(5, oldest=5), 0)
    assert numbers(ground) == [5, 6]
    # An older word of the oldest turns nothing back.
    ground.handle_message(numbered(7, oldest=2), 0)
    assert (numbers(ground), ground.duplicates) == ([7], 1)
    ground.handle_message(numbered(3), 0)
    assert ground.duplicates == 2
    # A number 64 or more ahead is out of reach.
    ground.handle_message(numbered(8 + 64), 0)
    assert ground.unexpected == 1
    ground.handle_message(numbered(8 + 63), 0)
    assert (ground.unexpected, numbers(ground)) == (1, [])


def test_each_message_handed_out_is_acknowledged_with_its_life():
    ground = end()
    for _ in range(2):
        ground.handle_message(numbered(3, oldest=3, boot_id=8), 0)
    # A new start of the sender begins with its own oldest, and what it held before is gone.
    for number, boot_id in ((5, 8), (4, 9), (7, 8)):
        ground.handle_message(numbered(number, oldest=4, boot_id=boot_id), 0)
    assert bodies(ground) == [Acknowledgement(8, 3), Acknowledgement(8, 3), Acknowledgement(9, 4)]
    assert [(event.boot_id, event.number) for event in events(ground)] == [(8, 3), (9, 4)]
    assert ground.unexpected == 1


def test_an_acknowledgement_of_another_life_or_number_is_unexpected():
    space = end(2)
    space.send(START, 0)
    space.handle_message(pack_body(Acknowledgement(2, 0)), 0)  # it was not sent yet
    assert space.poll_transmit(0) is not None
    for boot_id, number in ((1, 0), (2, 1)):
        space.handle_message(pack_body(Acknowledgement(boot_id, number)), 0)
    assert (space.unexpected, space.waiting) == (3, (0,))
    for now_ns in (9, 10):
        space.handle_message(pack_body(Acknowledgement(2, 0)), now_ns)
    # A repeated one tells nothing more.
    assert (events(space), space.unexpected) == ([Delivered(0, START, 9)], 4)


def test_a_message_names_its_life_its_number_and_the_oldest():
    space = end(2)
    for _ in range(3):
        space.send(START, 0)
    assert bodies(space) == [Numbered(2, number, 0, START) for number in range(3)]
    space.handle_message(pack_body(Acknowledgement(2, 0)), 0)
    assert k2aci.parse_body(space.poll_transmit(500 * MS)) == Numbered(2, 1, 1, START)
    assert (space.sent, space.repeated) == (4, 1)


@settings(max_examples=50)
@given(fates=st.tuples(FATES, FATES), silent=st.sampled_from((0, 60)))
def test_messages_arrive_once_and_in_order_both_ways(fates, silent):
    """Over loss, repetition, reordering, and a spell without a signal."""
    ends = end(timeout_ns=100 * MS), end(timeout_ns=100 * MS)
    paths = [LossyPath(fate) for fate in fates]
    lines = [chat(word) for word in "abcdefgh"]
    asked = [[one.send(line, 0) for line in lines] for one in ends]
    found = [], []
    for step in range(400):
        now_ns = step * 50 * MS
        for at, one in enumerate(ends):
            for octets in sent(one, now_ns):
                if not 1 <= step < silent:
                    paths[at].put(octets, step)
            for octets in paths[at].arrivals(step):
                ends[1 - at].handle_message(octets, now_ns)
        for heard, one in zip(found, ends, strict=True):
            heard += events(one)
        if step > silent and not any(one.waiting for one in ends):
            break
    for at in (0, 1):
        assert [one.message for one in found[at] if isinstance(one, Arrived)] == lines
        assert sorted(one.number for one in found[at] if isinstance(one, Delivered)) == asked[at]
