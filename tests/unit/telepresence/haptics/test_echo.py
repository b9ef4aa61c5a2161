"""How old the robot's commands are: what the probes say is true, and old ones move nothing."""

from collections import deque
from math import hypot
from random import Random

import pytest
from common import first_seed, repeats
from haptic_pair import MS, HapticPair

from kontur_av.errors import ProtocolError
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.echo import EchoProbe
from telepresence.haptics.envelope import Hold, SafetyEnvelope
from telepresence.haptics.sample import Echo, is_echo, is_greeting, pack_echo, read_echo


@pytest.mark.rule("S1")
@pytest.mark.parametrize("number", range(repeats(20)))
def test_no_command_is_older_than_the_probes_say(number):
    random = Random(first_seed(31) + number)
    probe, there, back = EchoProbe(), deque(), deque()
    delays_ms, newest_ms, heard = [10, 10], None, False
    for now_ms in range(20_000):
        if random.random() < 0.0005:
            delays_ms[random.randrange(2)] = random.choice((1, 10, 300, 4_000))
        if (echo := probe.poll_transmit(now_ms * MS)) is not None and random.random() > 0.05:
            there.append((max(now_ms + delays_ms[0], there[-1][0] if there else 0), echo.number))
        answer = there.popleft()[1] if there and there[0][0] <= now_ms else None
        if random.random() > 0.05:
            at_ms = max(now_ms + delays_ms[1], back[-1][0] if back else 0)
            back.append((at_ms, now_ms, answer))
        while back and back[0][0] <= now_ms:
            _, newest_ms, answer = back.popleft()
            if answer is not None:
                heard = True
                probe.handle_echo(Echo(answer), now_ms * MS)
        if heard:
            # Two intervals of the probes later it knows of any delay.
            assert now_ms - newest_ms <= probe.age_ns(now_ms * MS) / MS + 201, number


@pytest.mark.rule("S1")
def test_nothing_moves_by_commands_that_are_older_than_the_limit():
    envelope = SafetyEnvelope()
    pair = HapticPair(ground=RobotSide(envelope=envelope), delay_ms=10)
    path_m = [0.0] * 45
    for cycle in pair.cycles(45_000):
        pair.command_delay_ms = 4_000 if 10_000 <= cycle < 30_000 else 0
        pair.space.handle.handle_feedback(pair.space.link.latest(pair.now_ns))
        path_m[cycle // 1000] += hypot(pair.robot.vx_m_s, pair.robot.vy_m_s) / 1000
        if cycle == 25_000:
            assert envelope.hold in (Hold.AGE, Hold.LOST) and pair.space.link.told_age_ms > 4_000
            assert 4_000 <= envelope.report().command_age_ms < 4_300
    assert sum(path_m[:10]) > 0.05
    # It holds once commands are missing.
    assert sum(path_m[11:30]) < 0.001
    assert sum(path_m[35:]) > 0.05
    assert envelope.report().command_age_ms == 20.0


def test_an_echo_is_read_as_it_was_written_and_is_no_greeting():
    for feedback in (False, True):
        data = pack_echo(Echo(0x01020304, 4_000), 7, feedback=feedback, holding=False)
        assert data.hex(" ", 1) == f"00 07 {'c0' if feedback else '40'} 01 01 02 03 04 00 00 0f a0"
        assert is_echo(data) and not is_greeting(data)
        assert read_echo(data, feedback=feedback) == (7, Echo(0x01020304, 4_000))
        with pytest.raises(ProtocolError, match="other direction"):
            read_echo(data, feedback=not feedback)
        with pytest.raises(ProtocolError, match="no session"):
            read_echo(data[:1] + b"\0" + data[2:], feedback=feedback)
