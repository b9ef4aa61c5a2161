"""Haptic messages are read back as written; malformed ones are refused."""

import struct
from math import inf, nan, pi, tau

import pytest
from haptic_samples import unpack_command, unpack_feedback
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from telepresence.haptics import sample
from telepresence.haptics.latency import LatencyMatcher
from telepresence.haptics.mediated.wall import Wall, WallMessage, is_wall, pack_wall, parse_wall
from telepresence.haptics.ownership import HapticOwnership, Owner, PartnerBoard
from telepresence.haptics.sample import (
    Command,
    Feedback,
    Greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
    read_command,
    read_feedback,
    read_greeting,
)
from telepresence.haptics.session import JoystickSession, RobotSession

MS = 1_000_000
counts = st.integers(-32767, 32767)
energies = st.integers(0, (1 << 24) - 1)
bits = st.booleans()
NO_MORE = st.just(())
sequences, sessions = st.integers(0, 1 << 17), st.integers(1, 255)

COMMANDS = st.builds(
    Command,
    counts.map(lambda count: count * 20e-6),
    counts.map(lambda count: count * 20e-6),
    energies,
    *(bits, st.integers(0, 7), st.integers(0, 15), bits, bits, bits, bits, NO_MORE),
)
FEEDBACKS = st.builds(
    Feedback,
    counts.map(lambda count: count * 2e-3),
    counts.map(lambda count: count * 2e-3),
    energies,
    *(bits, st.integers(0, 3), st.none() | st.integers(0, 14), bits, bits, bits, bits, NO_MORE),
)


@settings(max_examples=60)
@given(COMMANDS, FEEDBACKS, sequences, sessions, bits)
def test_a_sample_is_read_as_it_was_written(command, feedback, sequence, session, holding):
    for value, pack, read in (
        (command, pack_command, read_command),
        (feedback, pack_feedback, read_feedback),
    ):
        data = pack(sequence, value, holding, session)
        assert len(data) == 12
        number, counted, flags, got = read(data)
        assert (number, counted) == (session, sequence % 65536)
        assert got[2:] == value[2:] and got[:2] == pytest.approx(value[:2])
        assert bool(flags & sample.FLAG_HOLDING) is holding
        assert not flags & (sample.FLAG_SATURATED | sample.FLAG_GREETING)
        # A total counts from the beginning of its session.
        base = value.energy_uj // 3
        assert read(pack(sequence, value, session=session, base_uj=base))[3].energy_uj == (
            value.energy_uj - base
        )
        other = read_feedback if read is read_command else read_command
        with pytest.raises(ProtocolError, match="instead of a"):
            other(data)


def test_bits_are_where_the_table_says():
    assert pack_command(
        0x1234, Command(0.06, -0.05, 6_016_277, stop=True, blind=True, buttons=0b0101), session=7
    ) == bytes.fromhex("1234 11 5b 0bb8 f63c 07 5bcd15")
    assert pack_command(
        1, Command(0.0, 0.0, 0, dead_man=False, state=4, acted=True, halted=True), holding=True
    ) == bytes.fromhex("0001 2c 04 0000 0000 01 000000")
    assert pack_feedback(
        0xFFFF, Feedback(-7.0, 0.5, (1 << 24) - 1, True, lit=2, stopped=True), session=255
    ) == bytes.fromhex("ffff 81 3b f254 00fa ff ffffff")
    assert pack_feedback(
        2, Feedback(0.0, 0.0, 0, False, mode=1, acted=True, halted=True, waiting=True), True
    ) == bytes.fromhex("0002 bc 01 0000 0000 01 000000")


@pytest.mark.parametrize(
    ("places", "counted"),
    [
        ((0.65534, -0.65534), (32767, -32767, 0)),
        ((0.655345, 0.0), (32767, 0, 0)),
        ((0.65536, -0.00005), (32767, -2, 2)),
        ((0.00005, -0.7), (2, -32767, 2)),
        ((inf, -inf), (32767, -32767, 2)),
    ],
)
def test_a_value_out_of_range_is_cut_and_flagged(places, counted):
    for data in (
        pack_command(0, Command(*places, 1 << 30, dead_man=False)),
        pack_feedback(0, Feedback(*(100.0 * place for place in places), 1 << 30, False)),
    ):
        flags, x, y, energy = struct.unpack(">xxBxhhI", data)
        assert (x, y, flags & 2) == counted
        # A total saturates, it never wraps.
        assert energy == 0x01FFFFFF


def test_a_bug_of_the_caller_raises():
    for bad in (Command(nan, 0.0, 0), Command(0.0, nan, 0), Command(0.0, 0.0, 0, state=8)):
        with pytest.raises(ValueError, match=r"NaN|no state 8"):
            pack_command(0, bad)
    for worse in (Feedback(nan, 0.0, 0, True), Feedback(0.0, 0.0, 0, True, mode=4)):
        with pytest.raises(ValueError, match=r"NaN|no mode 4"):
            pack_feedback(0, worse)


@pytest.mark.parametrize("feedback", [False, True])
def test_what_is_never_sent_is_refused(feedback):
    read = unpack_feedback if feedback else unpack_command
    kind = 0x80 if feedback else 0
    good = [0, 0, kind, 3, 0, 1, 0, 1, 1, 0, 0, 0]
    read(bytes(good))
    changes = [
        ({2: kind ^ 0x80}, "instead of a"),
        ({4: 0x80, 5: 0}, "-32768 is never sent"),
        ({6: 0x80, 7: 0}, "-32768 is never sent"),
        ({8: 0}, "no session"),
        ({2: kind | 0x40}, "no session"),
    ]
    if feedback:
        changes.append(({3: 4}, "no mode 4"))
    for change, words in changes:
        with pytest.raises(ProtocolError, match=words):
            read(bytes({**dict(enumerate(good)), **change}.values()))
    for length in (0, 11, 13):
        with pytest.raises(ProtocolError, match=f"{length} octets instead of 12"):
            read(bytes(length))


@given(
    st.integers(0, 255), st.integers(1, (1 << 32) - 1), st.integers(0, (1 << 32) - 1), bits, bits
)
def test_a_greeting_is_read_as_it_was_written(session, number, answers, partner, feedback):
    greeting = Greeting(session, number, answers, partner)
    for holding in (False, True):
        data = pack_greeting(greeting, feedback=feedback, holding=holding)
        assert data[2] == 0x40 | 0x80 * feedback | 0x20 * partner | 0x04 * holding
        assert sample.is_greeting(data) and not sample.is_greeting(data + b"\0")
        assert read_greeting(data, feedback=feedback) == greeting
        with pytest.raises(ProtocolError, match="other direction"):
            read_greeting(data, feedback=not feedback)
    for change in ({0: 1}, {3: 1}, {4: 0, 5: 0, 6: 0, 7: 0}):
        with pytest.raises(ProtocolError, match="octets 0 and 3"):
            read_greeting(bytes({**dict(enumerate(data)), **change}.values()), feedback=feedback)


@given(
    st.integers(0, 1 << 25),
    st.integers(0, 1 << 15),
    st.integers(0, 65535),
    counts,
    st.integers(10, 20_000),
)
def test_a_wall_is_read_as_it_was_written(stamp_ms, count, turn, distance, stiffness):
    wall = Wall(turn * tau / 65536, distance * 20e-6, float(stiffness))
    data = pack_wall(WallMessage(stamp_ms, wall), count)
    assert is_wall(data) and len(data) == 16
    # CCSDS 133.0-B-2: version 0, telemetry, this APID; unsegmented; its length less one.
    assert struct.unpack_from(">HHH", data) == (0x103, 0xC000 | count % 16384, 9)
    read = parse_wall(data)
    assert read.stamp_ms == stamp_ms % (1 << 24)
    assert (read.wall.angle_rad, read.wall.distance_m, read.wall.stiffness_n_m) == pytest.approx(
        (wall.angle_rad, wall.distance_m, wall.stiffness_n_m)
    )
    none = pack_wall(WallMessage(stamp_ms, None), count)
    assert parse_wall(none) == WallMessage(stamp_ms % (1 << 24), None)
    assert none[6:9] == b"\x02\0\0" and none[12:] == bytes(4)


def test_a_wall_out_of_range_is_cut_and_one_that_is_never_sent_refused():
    for wall, cut in (
        (Wall(tau - 1e-6, 9.0, 1e6), (0.0, 0.65534, 20_000.0)),
        (Wall(-pi / 2, -9.0, 0.1), (1.5 * pi, -0.65534, 10.0)),
    ):
        read = parse_wall(pack_wall(WallMessage(0, wall), 0)).wall
        assert (read.angle_rad, read.distance_m, read.stiffness_n_m) == pytest.approx(cut)
    good = list(pack_wall(WallMessage(5, Wall(1.0, 0.05, 1500.0)), 3))
    none = list(pack_wall(WallMessage(5, None), 3))
    for octets, change, words in (
        (good, {1: 4}, "header of its space packet"),
        (good, {2: 0x40}, "header of its space packet"),
        (good, {5: 10}, "header of its space packet"),
        (good, {6: 1}, "version 1 instead of 2"),
        (good, {12: 0x80, 13: 0}, "never sent"),
        (good, {14: 0, 15: 9}, "stiffness of 9 N/m"),
        (good, {14: 0x4E, 15: 0x21}, "stiffness of 20001 N/m"),
        (none, {8: 1}, "of no wall"),
        (none, {13: 1}, "of no wall"),
    ):
        data = bytes({**dict(enumerate(octets)), **change}.values())
        assert is_wall(data) is ("header" not in words)
        with pytest.raises(ProtocolError, match=words):
            parse_wall(data)
    for data in (bytes(good[:-1]), bytes([*good, 0])):
        assert not is_wall(data)
        with pytest.raises(ProtocolError, match="octets instead of 16"):
            parse_wall(data)


def test_a_plane_pushes_from_its_surface_on():
    wall = Wall(pi / 6, 0.05, 1000.0)
    x, y = wall.inward
    assert (x, y) == pytest.approx((3**0.5 / 2, 0.5))
    assert wall.depth_m(0.052 * x, 0.052 * y) == pytest.approx(0.002)
    assert wall.force_n(0.052 * x - y, 0.052 * y + x) == pytest.approx((-2.0 * x, -2.0 * y))
    assert wall.force_n(0.049 * x, 0.049 * y) == pytest.approx((0.0, 0.0))
    moved = wall.moved(0.01, -0.03)
    assert moved.distance_m == pytest.approx(0.05 + 0.01 * x - 0.03 * y)
    assert (moved.angle_rad, moved.stiffness_n_m) == (wall.angle_rad, wall.stiffness_n_m)


def rest(board, now_ns):
    """The robot at hand rests for as long as a handover takes."""
    for ms in range(301):
        board.ownership.handle_robot(0.0, now_ns + ms * MS)
    return now_ns + 301 * MS


def test_a_joystick_drives_one_of_two_robots():
    board = PartnerBoard(HapticOwnership())
    ours = pack_command(1, Command(0.0, 0.0, 0))
    asks = [pack_greeting(Greeting(0, 9, 0, who), feedback=False, holding=True) for who in (0, 1)]
    theirs = pack_feedback(1, Feedback(0.0, 0.0, 0, False))
    assert (board.left_out, board.state(0), board.is_there(0)) == (False, "absent", False)
    assert board.handle_joystick(ours, 0) and board.handle_joystick(asks[0], 0)
    board.handle_partner(theirs, 0)
    # It is there, and neither of the two hears of the other.
    assert [board.state(ms * MS) for ms in (0, 500, 501)] == ["ready", "ready", "absent"]
    assert board.poll_joystick() is None and board.poll_partner(stopped=False) is None
    # The first request for the other ends what was; the samples of neither are taken meanwhile.
    assert not board.handle_joystick(asks[1], MS) and board.left_out
    assert not board.handle_joystick(ours, MS) and board.poll_partner(stopped=False) is None
    assert board.ownership.report().refused == {"iss": 2, "partner": 0}
    now_ns = rest(board, MS)
    assert board.left_out and board.ownership.owner is Owner.PARTNER
    for data in (asks[1], ours):
        assert not board.handle_joystick(data, now_ns)
    # The newest alone goes on, and once; an emergency stop holds it back.
    assert board.poll_partner(stopped=False) == ours and board.poll_partner(stopped=False) is None
    board.handle_joystick(ours, now_ns)
    assert board.poll_partner(stopped=True) is None and board.poll_partner(stopped=False) is None
    board.handle_partner(theirs, now_ns)
    assert board.state(now_ns) == "driven"
    assert board.poll_joystick() == theirs and board.poll_joystick() is None
    # A malformed greeting is ignored; the caller counts it.
    garbled = bytes([1]) + asks[0][1:]
    assert board.handle_joystick(garbled, now_ns) is False
    assert board.ownership.wanted is Owner.PARTNER
    assert not board.handle_joystick(asks[0], now_ns) and board.left_out
    rest(board, now_ns)
    assert not board.left_out and board.handle_joystick(garbled, now_ns)


@pytest.mark.parametrize("data", [b"", bytes(11), bytes(13), pack_command(0, Command(0, 0, 0))])
def test_a_partner_that_sends_garbage_is_not_there(data):
    board = PartnerBoard(HapticOwnership(Owner.PARTNER))
    board.handle_partner(data, 0)
    assert (board.ownership.garbage, board.is_there(0)) == (1, False)
    assert board.poll_joystick() is None


def test_an_order_that_is_given_again_changes_nothing_and_rest_is_needed():
    ownership = HapticOwnership()
    ownership.handle_order(Owner.ISS, 0)
    assert ownership.owner is Owner.ISS and ownership.report().events == ()
    ownership.handle_order(Owner.PARTNER, 0)
    for ms in range(1000):
        assert not ownership.handle_robot(0.0051, ms * MS)
    # At rest from the last motion on, at 999 ms.
    found = [ms for ms in range(1000, 1700) if ownership.handle_robot(0.005, ms * MS)]
    assert found == [1299]
    figures = ownership.report()
    assert (figures.owner, figures.turns) == (Owner.PARTNER, 1)
    assert [event.what for event in figures.events] == ["handing over to partner", "partner drives"]
    # While nobody drives, an order changes who will, and rest goes on.
    ownership.handle_order(Owner.ISS, 2000 * MS)
    for ms in range(2000, 2200):
        ownership.handle_robot(0.0, ms * MS)
    ownership.handle_order(Owner.PARTNER, 2200 * MS)
    found = [ms for ms in range(2200, 2500) if ownership.handle_robot(0.0, ms * MS)]
    assert found == [2300] and ownership.owner is Owner.PARTNER


def greeted(session, polls, granted_uj=0, now_ns=0):
    """What a session puts in the place of the next samples, by their number."""
    found = {}
    for number in range(polls):
        greeting = session.poll_greeting(granted_uj, now_ns)
        if greeting is not None:
            found[number] = greeting
    return found


def begun():
    joystick = JoystickSession(5)
    joystick.handle_greeting(Greeting(0, 7 << 8))
    (request,) = greeted(joystick, 1).values()
    joystick.handle_greeting(Greeting(40, 7 << 8, request.number))
    assert joystick.handle_change(40)
    return joystick


def test_a_joystick_asks_in_each_place_until_it_can_send_and_then_in_every_twentieth():
    joystick = JoystickSession(5)
    assert set(greeted(joystick, 30)) == set(range(30))
    joystick.handle_greeting(Greeting(0, 7 << 8))
    requests = greeted(joystick, 3)
    assert set(requests.values()) == {Greeting(0, 5 << 8, 7 << 8)}
    # An answer to another request is ignored.
    joystick.handle_greeting(Greeting(9, 7 << 8, (5 << 8) + 1))
    assert joystick.sending == 0
    joystick.handle_greeting(Greeting(40, 7 << 8, 5 << 8))
    assert (joystick.sending, joystick.receiving) == (40, 0)
    # It sends now, and asks on until a sample of the session comes.
    assert sorted(greeted(joystick, 60)) == [19, 39, 59]
    assert not joystick.handle_change(41) and joystick.handle_change(40)
    assert (joystick.sending, joystick.receiving, joystick.restarts) == (40, 40, 0)
    assert greeted(joystick, 100) == {}


def test_a_joystick_renews_a_session_before_its_numbers_or_energies_run_out():
    joystick = begun()
    for now_ns in (0, 30_000 * MS - 1):
        assert greeted(joystick, 1, now_ns=now_ns) == {}
    (request,) = greeted(joystick, 1, now_ns=30_000 * MS).values()
    assert request == Greeting(40, (5 << 8) + 1, 7 << 8)
    joystick = begun()
    half_uj = (1 << 24) // 2 - 1
    assert greeted(joystick, 1, half_uj) == {} and len(greeted(joystick, 1, half_uj + 1)) == 1
    # The renewed session has the same robot, so nobody has restarted.
    joystick.handle_greeting(Greeting(41, 7 << 8, (5 << 8) + 1))
    assert joystick.handle_change(41) and joystick.restarts == 0
    # Its next renewal is 30 s after that.
    assert greeted(joystick, 1, now_ns=50_000 * MS) == {}
    assert greeted(joystick, 1, now_ns=79_999 * MS) == {}
    assert len(greeted(joystick, 1, now_ns=80_000 * MS)) == 1
    joystick.handle_greeting(Greeting(42, 8 << 8, (5 << 8) + 2))
    assert joystick.handle_change(42) and joystick.restarts == 1


def test_strays_make_a_joystick_ask_anew_and_another_robot_makes_it_forget():
    joystick = begun()
    for _ in range(19):
        assert not joystick.handle_change(3)
    assert greeted(joystick, 1) == {}
    joystick.handle_change(3)
    assert (len(greeted(joystick, 1)), joystick.strays) == (1, 20)
    joystick.handle_greeting(Greeting(50, 9 << 8, (5 << 8) + 1, partner=True))
    assert joystick.partner_there
    joystick.begin_anew(for_partner=True)
    assert (joystick.sending, joystick.receiving, joystick.partner_there) == (0, 0, False)
    assert set(greeted(joystick, 2).values()) == {Greeting(0, (5 << 8) + 2, 0, True)}
    # The offer of before answers no longer, and another life is no restart.
    joystick.handle_greeting(Greeting(50, 9 << 8, (5 << 8) + 1))
    assert joystick.sending == 0
    joystick.handle_greeting(Greeting(60, 9 << 8, (5 << 8) + 2))
    assert joystick.handle_change(60) and joystick.restarts == 0


def test_a_robot_answers_each_eighth_place_and_tells_each_hundredth_of_a_partner():
    robot = RobotSession(7)
    assert set(greeted(robot, 5).values()) == {Greeting(0, 7 << 8)} and robot.asking == 0
    robot.handle_greeting(Greeting(0, 5 << 8, 7 << 8))
    assert robot.asking == 5
    (offer,) = greeted(robot, 1).values()
    assert offer[1:] == (7 << 8, 5 << 8, False)
    assert robot.handle_change(offer.session) and robot.sending == offer.session
    assert greeted(robot, 500) == {}
    robot.partner = True
    told = greeted(robot, 500)
    assert [b - a for a, b in zip(told, list(told)[1:], strict=False)] == [100] * (len(told) - 1)
    assert set(told.values()) == {Greeting(offer.session, 7 << 8, 0, True)}
    robot.partner = None
    found = []
    for number in range(40):
        robot.handle_greeting(Greeting(offer.session, (5 << 8) + 1, 7 << 8))
        found += [number] * len(greeted(robot, 1))
    assert found == [0, 8, 16, 24, 32]
    # The next session is of the same life; one of another life is a restart.
    robot.handle_change(offer.session + 1)
    assert (robot.receiving, robot.restarts) == (offer.session + 1, 0)
    robot.handle_greeting(Greeting(0, 6 << 8, 7 << 8))
    (offer,) = greeted(robot, 8).values()
    assert robot.handle_change(offer.session) and robot.restarts == 1


def test_a_robot_remembers_eight_offers_and_repeats_them():
    robot = RobotSession(7)
    offers = {}
    for number in range(9):
        robot.handle_greeting(Greeting(0, (5 << 8) + number, 7 << 8))
        (offer,) = greeted(robot, 1).values()
        offers[number] = offer.session
    assert len(set(offers.values())) == 9
    for number in range(1, 9):
        robot.handle_greeting(Greeting(0, (5 << 8) + number, 7 << 8))
        (again,) = greeted(robot, 1).values()
        assert again.session == offers[number]
    assert not robot.handle_change(offers[0]) and robot.handle_change(offers[1])
    # It has the session that began, and no other of these offers.
    assert not robot.handle_change(offers[2])


@pytest.mark.parametrize("number", [0, -1, 1 << 24])
def test_the_number_of_a_life_has_a_range(number):
    for session in (JoystickSession, RobotSession):
        with pytest.raises(ValueError, match="1 to 16777215"):
            session(number)
        assert session((1 << 24) - 1).restarts == session(1).restarts == 0


def test_a_session_number_is_followed_by_the_next_and_the_last_by_the_first():
    for before, after in ((254, 255), (255, 1), (1, 2)):
        robot = RobotSession(7)
        robot.handle_greeting(Greeting(before, 5 << 8, 7 << 8))
        (offer,) = greeted(robot, 1).values()
        assert offer.session == after
    # Two ends that have just begun take it from both of their lives.
    robot = RobotSession(7)
    robot.handle_greeting(Greeting(0, (5 << 8) + 3, 7 << 8))
    (offer,) = greeted(robot, 1).values()
    assert offer.session == 5 + 7 + 1


def test_a_sent_stamp_is_known_once_it_has_come():
    matcher = LatencyMatcher()
    matcher.handle_sent([(65535, 5 * MS), (0, 6 * MS)])
    assert [matcher.sent_ns(number) for number in (65535, 0, 1)] == [5 * MS, 6 * MS, None]
