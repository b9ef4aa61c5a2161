"""Any datagrams in any order: each is counted once, and nothing raises."""

from haptic_samples import unpack_command, unpack_feedback
from haptic_session import begin_session
from hypothesis import given
from hypothesis import strategies as st

from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.sample import (
    FLAG_HOLDING,
    FLAG_SATURATED,
    POSITION_M,
    Command,
    Feedback,
    pack_command,
    pack_feedback,
)

counts = st.integers(-32767, 32767)
energies = st.integers(0, (1 << 24) - 1)
sessions = st.integers(1, 255)
nibbles = st.integers(0, 15)


@given(
    sessions,
    st.integers(0, 65535),
    counts,
    counts,
    energies,
    st.integers(0, 7),
    nibbles,
    st.tuples(*[st.booleans()] * 4),
)
def test_command_round_trip(
    session: int,
    sequence: int,
    x: int,
    y: int,
    uj: int,
    state: int,
    buttons: int,
    flags: tuple[bool, ...],
) -> None:
    dead_man, acted, halted, holding = flags
    command = Command(x * 20e-6, y * 20e-6, uj, dead_man, state, buttons, acted, halted)
    octets = pack_command(sequence, command, holding, session)
    sample = unpack_command(octets)
    assert (sample.session, sample.sequence, sample.value) == (session, sequence, command)
    assert bool(sample.flags & FLAG_HOLDING) is holding
    assert pack_command(sample.sequence, sample.value, holding, session) == octets


@given(
    sessions,
    st.integers(0, 65535),
    counts,
    counts,
    energies,
    st.integers(0, 3),
    st.none() | st.integers(0, 14),
    st.tuples(*[st.booleans()] * 4),
)
def test_feedback_round_trip(
    session: int,
    sequence: int,
    fx: int,
    fy: int,
    uj: int,
    mode: int,
    lit: int | None,
    flags: tuple[bool, ...],
) -> None:
    contact, acted, halted, holding = flags
    feedback = Feedback(fx * 2e-3, fy * 2e-3, uj, contact, mode, lit, acted, halted)
    octets = pack_feedback(sequence, feedback, holding, session)
    sample = unpack_feedback(octets)
    assert (sample.session, sample.sequence, sample.value) == (session, sequence, feedback)
    assert bool(sample.flags & FLAG_HOLDING) is holding
    assert pack_feedback(sample.sequence, sample.value, holding, session) == octets


@given(st.floats(allow_nan=False), st.floats(allow_nan=False), st.integers(0, 1 << 80))
def test_values_round_trip_within_half_a_count_or_saturate(x: float, y: float, uj: int) -> None:
    sample = unpack_command(pack_command(0, Command(x, y, uj)))
    saturated = bool(sample.flags & FLAG_SATURATED)
    assert saturated is (max(abs(x), abs(y)) / POSITION_M >= 32767.5)
    for sent, read in ((x, sample.value.x_m), (y, sample.value.y_m)):
        limited = max(-0.65534, min(0.65534, sent))
        assert abs(read - limited) <= POSITION_M / 2 + 1e-12
    assert sample.value.energy_uj == min(uj, (1 << 24) - 1)


@given(st.lists(st.binary(max_size=14) | st.binary(min_size=12, max_size=12), max_size=50))
def test_everything_is_counted_exactly_once(datagrams: list[bytes]) -> None:
    for link in (robot_link(), joystick_link()):
        for now_ns, data in enumerate(datagrams):
            link.handle_datagram(data, now_ns * 1_000_000)
            # Whatever was heard, it can be answered.
            link.poll_transmit(now_ns * 1_000_000)
        counted = link.received + link.late + link.repeated + link.strays + link.greetings
        assert counted + link.garbage == len(datagrams)


@given(
    st.integers(0, 65535),
    st.lists(st.sampled_from(["deliver", "lose", "repeat", "swap"]), min_size=1, max_size=300),
)
def test_counters_are_correct_for_any_path(first: int, path: list[str]) -> None:
    """Compares with simple counting on unbounded sequence numbers."""
    link = robot_link()
    session = begin_session(link)
    arrivals: list[int] = []
    for number, fate in enumerate(path):
        if fate == "deliver":
            arrivals.append(number)
        elif fate == "repeat":
            arrivals += [number, number]
        elif fate == "swap":
            arrivals.insert(max(0, len(arrivals) - 1), number)
    newest, seen = -1, set()
    received = late = repeated = 0
    begin = arrivals[0] if arrivals else 0
    for now, number in enumerate(arrivals):
        data = pack_command(first + number, Command(0.0, 0.0, 0), session=session)
        link.handle_datagram(data, now * 1_000_000)
        if number in seen or number < begin:
            repeated += 1
        elif number > newest:
            received, newest = received + 1, number
        else:
            late += 1
        seen.add(number)
    numbers = {number for number in seen if number >= begin}
    lost = newest - begin + 1 - len(numbers) if arrivals else 0
    report = link.received_figures()
    assert (report.received, report.late, report.repeated, report.lost) == (
        received,
        late,
        repeated,
        lost,
    )
    assert report.restarts == 0
