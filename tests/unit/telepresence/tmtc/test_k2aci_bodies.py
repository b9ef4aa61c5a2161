"""K2ACI octet by octet: CBOR written out by hand after RFC 8949."""

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.k2aci import (
    MAX_BODY_OCTETS,
    Acknowledgement,
    Chat,
    ChatRole,
    Numbered,
    PanelMode,
    PanelState,
    StartTask,
    TaskFinished,
    TaskGoal,
    TaskProgress,
    TaskResult,
    TaskSelected,
    pack_body,
    parse_body,
)

GOLDEN = [
    (
        # [1, 258, 7, 5, "aiming", 3, [-1, 24], ""]
        "88 01 190102 07 05 6661696d696e67 03 8220 1818 60",
        Numbered(258, 7, 5, TaskSelected(task="aiming", run=3, start_um=(-1, 24))),
    ),
    ("86 02 00 00 00 6161 01", Numbered(0, 0, 0, StartTask(task="a", run=1))),
    (
        "89 03 00 00 00 6161 01 67 61626f72746564 1903e8 60",
        Numbered(
            0, 0, 0, TaskFinished(task="a", run=1, result=TaskResult.ABORTED, duration_ms=1000)
        ),
    ),
    ("88 04 00 00 00 64 686f6c64 60 00 60", Numbered(0, 0, 0, PanelState(mode=PanelMode.HOLD))),
    (
        "86 05 1affffffff 09 09 69 63 6f736d6f6e617574 62 c3bc",
        Numbered((1 << 32) - 1, 9, 9, Chat(sender=ChatRole.COSMONAUT, text="ü")),
    ),
    (
        # [6, 0, 0, 0, 1, "reach", 2, 4, [-45000, 0], 0, 0, 0, 500, 1, 60000]
        "8f 06 00 00 00 01 65 7265616368 02 04 82 39afc7 00 00 00 00 1901f4 01 19ea60",
        Numbered(
            0,
            0,
            0,
            TaskProgress(
                run=1,
                goal=TaskGoal.REACH,
                step=2,
                steps=4,
                place_um=(-45_000, 0),
                hold_ms=500,
                held_ms=1,
                left_ms=60_000,
            ),
        ),
    ),
    ("83 00 190102 07", Acknowledgement(258, 7)),
]


@pytest.mark.parametrize(("octets", "body"), GOLDEN)
def test_bodies_have_these_octets(octets: str, body: Numbered | Acknowledgement) -> None:
    assert pack_body(body) == bytes.fromhex(octets)
    assert parse_body(bytes.fromhex(octets)) == body


def test_the_longest_message_fits() -> None:
    most = (1 << 32) - 1
    chat = Chat(sender=ChatRole.EXPERIMENTER, text="x" * 200)
    task = TaskSelected(task="t" * 32, run=most, start_um=(-1_000_000, 1_000_000), text="x" * 128)
    octets = [pack_body(Numbered(most, most, most, message)) for message in (chat, task)]
    assert max(map(len, octets)) == MAX_BODY_OCTETS
    assert [parse_body(one).message for one in octets] == [chat, task]


@pytest.mark.parametrize(
    "octets",
    [
        "",
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
def test_other_octets_are_refused(octets: str) -> None:
    with pytest.raises(ProtocolError, match="K2ACI: "):
        parse_body(bytes.fromhex(octets))


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: Chat(sender=ChatRole.COSMONAUT, text="x" * 201), "text has 201 octets: give 1 to"),
        (lambda: StartTask(task="t" * 33, run=1), "task has 33 octets: give 1 to 32"),
        (lambda: StartTask(task="a\nb", run=1), "one line of printable text"),
        (lambda: StartTask(task=5, run=1), "one line of printable text"),
        (lambda: StartTask(task="a", run=-1), "run is -1"),
        (lambda: StartTask(task="a", run=1 << 32), "run is 4294967296"),
        (lambda: StartTask(task="a", run=True), "run is True"),
        (lambda: TaskFinished(task="a", run=1, result="done"), "choose one of finished, aborted"),
        (lambda: TaskSelected(task="a", run=1, start_um=(1, 2, 3)), "give two integers"),
        (lambda: TaskSelected(task="a", run=1, start_um=[1, 2]), "give two integers"),
        (lambda: TaskSelected(task="a", run=1, start_um=(1_000_001, 0)), "up to ±1000000"),
        (lambda: TaskSelected(task="a", run=1, start_um=(0, -1_000_001)), "up to ±1000000"),
        (lambda: TaskSelected(task="a", run=1, start_um=(0, 0.5)), "up to ±1000000"),
        (lambda: TaskProgress(run=1, goal=TaskGoal.CIRCLE), "a spot needs the time of a turn"),
        (lambda: Numbered(0, 1, 2, StartTask(task="a", run=1)), "oldest 2 is above the number 1"),
    ],
)
def test_unfit_messages_are_refused_when_they_are_made(make, line) -> None:
    with pytest.raises(ConfigError, match=line):
        make()


def test_octets_that_no_packet_holds_are_refused() -> None:
    with pytest.raises(ProtocolError, match="233 octets, not 1 to 232"):
        parse_body(bytes(233))


def test_what_a_message_does_not_say_is_nothing() -> None:
    """[1, 0, 0, 0, "a", 1, [0, 0], ""], and the same of a goal."""
    selected = pack_body(Numbered(0, 0, 0, TaskSelected(task="a", run=1)))
    assert selected == bytes.fromhex("88 01 00 00 00 6161 01 820000 60")
    finished = pack_body(
        Numbered(0, 0, 0, TaskFinished(task="a", run=1, result=TaskResult.ABORTED))
    )
    assert finished == bytes.fromhex("89 03 00 00 00 6161 01 67 61626f72746564 00 60")
    goal = pack_body(Numbered(0, 0, 0, TaskProgress(run=1, goal=TaskGoal.FREE)))
    assert goal == bytes.fromhex("8f 06 00 00 00 01 64 66726565 01 01 820000" + "00" * 6)
    # At the limits a place is one.
    TaskSelected(task="a", run=(1 << 32) - 1, start_um=(1_000_000, -1_000_000))
    TaskProgress(run=1, goal=TaskGoal.EIGHT, turn_ms=1)
