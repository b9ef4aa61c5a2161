"""What another ground system may send, how fast, and what it gets."""

import re
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.link.figures import pack_frames
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import CommandUpdate, FunctionAsked, FunctionDone
from pipelines.packets.bridge import (
    COMMANDS_AT_ONCE,
    PacketBridge,
    PacketSplitter,
    PeerQueue,
    allowed_commands,
)
from pipelines.packets.process_packets import FrameCopies, parse_frames
from pipelines.packets.yamcs import instance_files
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, pack_packet, parse_packet
from telepresence.tmtc.pus.verification import (
    Failure,
    VerificationStage,
    pack_refusal,
    parse_verification,
    verification_of,
)

DICTIONARY = built_in_dictionary()
S = 1_000_000_000


def command(application, service, subtype, data=b"", count=5):
    apid = DICTIONARY.application(application).apid
    return pack_packet(
        Telecommand(apid=apid, count=count, service=service, subtype=subtype, data=data)
    )


def function(application, name, count=5, data=b""):
    number = DICTIONARY.application(application).function(name).number
    return command(application, 8, 1, bytes([number]) + data, count)


def bridge(*words):
    allowed = allowed_commands(words, DICTIONARY)
    return PacketBridge(DICTIONARY, allowed, client="it", source=3, epoch_ns=0)


def passed(given, octets):
    given.handle_command(octets, 0)
    request = given.poll_request()
    if request is not None:
        given.handle_sent()
    return request


def test_only_questions_pass_unless_more_is_allowed():
    moves = [function("robot", "power_on"), function("joystick", "halt"), command("robot", 12, 2)]
    for octets in moves:
        assert passed(bridge(), octets) is None
    for octets in (command("robot", 17, 1), command("robot", 20, 1, b"\1\1")):
        assert passed(bridge(), octets).packet == octets
    one = bridge("joystick.halt")
    assert passed(one, moves[1]) is not None
    assert passed(one, function("joystick", "resume")) is None
    assert passed(one, moves[0]) is None
    assert passed(bridge("robot"), moves[2]) is not None
    assert all(passed(bridge("all"), octets) is not None for octets in moves)


@pytest.mark.parametrize(
    ("word", "mend"), [("oven", "joystick"), ("robot.fly", "power_on"), ("camera.", "select")]
)
def test_a_word_that_allows_nothing_is_a_mistake(word, mend):
    with pytest.raises(ConfigError, match=mend):
        allowed_commands([word], DICTIONARY)


def test_what_is_not_allowed_fails_at_acceptance():
    given = bridge()
    given.handle_command(function("robot", "power_on", count=9), 7 * S)
    report = parse_packet(given.poll_report())
    assert (report.service, report.destination, report.cuc) == (1, 3, 7 << 16)
    about = parse_verification(report.subtype, report.data)
    assert (about.apid, about.count, about.failure) == (0x131, 9, Failure.REFUSED)
    assert given.figures.outside_refused == 1
    assert given.poll_report() is None


def test_a_flood_is_dropped_and_garbage_is_counted():
    given = bridge()
    given.handle_command(b"nonsense", 0)
    report = bytes.fromhex("093300000012")
    given.handle_command(report, 0)
    for number in range(100):
        given.handle_command(command("robot", 17, 1, count=number), 0)
    assert given.figures.outside_garbage == 2
    assert given.figures.outside_excess == 102 - COMMANDS_AT_ONCE
    given.handle_command(command("robot", 17, 1, count=200), S)
    assert given.figures.outside_excess == 102 - COMMANDS_AT_ONCE


def test_a_refusal_of_the_end_is_told():
    given = bridge("all")
    request = passed(given, function("robot", "power_on", count=4))
    told = CommandUpdate("it", request.id, "robot", "refused", done=True, reason="too many")
    given.handle_news(told, 0)
    report = parse_packet(given.poll_report())
    about = parse_verification(report.subtype, report.data)
    assert (about.count, about.reason) == (4, "too many")


def test_a_stream_is_split_into_packets_and_no_other_stream():
    first, second = command("robot", 17, 1), function("joystick", "halt")
    splitter = PacketSplitter()
    found = []
    for octet in first + second:
        found += splitter.handle_octets(bytes([octet]))
    assert found == [first, second]
    with pytest.raises(ProtocolError):
        splitter.handle_octets(b"GET / HTTP/1.1\r\n")


def test_a_slow_peer_loses_the_oldest_but_no_half_packet():
    queue = PeerQueue()
    queue.put(b"first", 0)
    queue.handle_written(2, 0)
    for number in range(PeerQueue.DEPTH):
        queue.put(bytes([number]), 1)
    assert queue.dropped == 1
    assert queue.octets == b"rst"
    queue.handle_written(3, 5)
    assert queue.max_age_ns == 5
    assert queue.octets == bytes([1])


def ends():
    """Both ends, and a function that lets them talk and returns what they asked for."""
    made = {one: TmtcEnd(one, DICTIONARY, now_ns=0, first_count=5, life=1) for one in Segment}

    def talk(now_ns):
        local, asked = {one: [] for one in Segment}, []
        for _ in range(4):
            for segment, end in made.items():
                while (packet := end.poll_transmit(now_ns)) is not None:
                    made[segment.peer].handle_packet(packet, now_ns)
                    local[segment.peer].append(packet)
                while (packet := end.next_local()) is not None:
                    local[segment].append(packet)
                while (news := end.next_event()) is not None:
                    if isinstance(news, FunctionAsked):
                        asked.append((news.application, news.function))
                        end.handle_request(FunctionDone(news.application, news.token), now_ns)
        return local, asked

    return made, talk


@pytest.mark.parametrize("application", ["joystick", "robot"])
def test_a_foreign_telecommand_is_carried_out_and_verified_at_either_end(application):
    given, (made, talk) = bridge("all"), ends()
    name = {"joystick": "halt", "robot": "power_off"}[application]
    request = passed(given, function(application, name, count=5))
    # The own user's telecommand of the same count is another one.
    made[Segment.GROUND].handle_request(request, 0)
    seen, asked = talk(0)
    assert asked == [(application, name)]
    found = [parse_packet(octets) for octets in seen[Segment.GROUND]]
    stages = [one.subtype for one in found if one.service == 1 and one.destination == 3]
    assert stages == [1, 3, 7]
    # It has ended: nothing is repeated.
    assert not talk(20 * S)[1]


def test_foreign_telecommands_leave_room_for_the_own_user():
    made, _ = ends()
    ground = made[Segment.GROUND]
    given = bridge("all")
    for number in range(6):
        ground.handle_request(passed(given, function("joystick", "halt", count=number)), 0)
    ground.poll_transmit(0)
    stages = []
    while (news := ground.next_event()) is not None:
        stages.append(news.stage)
    assert stages.count("taken") == 4
    assert stages.count("refused") == 2


@pytest.mark.parametrize("application", ["joystick", "robot"])
def test_a_system_that_began_anew_is_heeded_and_a_repetition_is_not(application):
    """Its counts begin anew, too, so its telecommands are octet by octet those of its last life."""
    given, (made, talk) = bridge("all"), ends()
    name = {"joystick": "halt", "robot": "power_off"}[application]
    octets = function(application, name, count=0)
    now_ns = 0

    def carried_out(connection, *, told=True):
        nonlocal now_ns
        now_ns += S
        given.handle_command(octets, now_ns, connection)
        made[Segment.GROUND].handle_request(given.poll_request(), now_ns)
        given.handle_sent()
        seen, asked = talk(now_ns)
        for packet in seen[Segment.GROUND] if told else ():
            given.handle_telemetry(packet)
        found = [parse_packet(packet) for packet in seen[Segment.GROUND]]
        assert [one.subtype for one in found if one.service == 1] == [1, 3, 7]
        return len(asked)

    first, second, third, fourth, fifth = (given.handle_connection() for _ in range(5))
    assert carried_out(first, told=False) == 1
    # What is acknowledged is not yet the report of its end.
    given.handle_heard(first)
    assert carried_out(second) == 0
    # The first one was lost before it had the report, and may be the third one, too.
    given.handle_heard(second)
    assert carried_out(third, told=False) == 0
    # The third one missed the report that the others have.
    for one in (first, second, third):
        given.handle_heard(one)
    assert carried_out(fourth) == 0
    for one in (first, second, third, fourth):
        given.handle_heard(one)
    assert carried_out(third) == 0
    # All that sent it know its end, so none of them repeats it.
    given.handle_heard(third)
    assert carried_out(fifth) == 1
    assert carried_out(fifth) == 0
    given.handle_heard(fifth)
    assert carried_out(first) == 1


@pytest.mark.parametrize(
    ("stage", "failure", "source", "edition"),
    [
        (VerificationStage.ACCEPTED, None, 3, 0),
        (VerificationStage.STARTED, None, 3, 0),
        (VerificationStage.COMPLETED, None, 4, 0),
        (VerificationStage.COMPLETED, None, 3, 1),
        (VerificationStage.ACCEPTED, Failure.BAD_DATA, 3, 1),
    ],
)
def test_only_the_report_of_its_end_makes_room_for_an_equal_telecommand(
    stage, failure, source, edition
):
    given, octets = bridge("all"), function("robot", "power_off")
    first, second = given.handle_connection(), given.handle_connection()
    given.handle_command(octets, 0, first)
    given.handle_sent()
    command = parse_packet(octets)
    report = verification_of(command, stage, failure, "no")
    given.handle_telemetry(pack_refusal(command, report, count=0, destination=source, unix_ns=0))
    given.handle_heard(first)
    given.handle_command(octets, S, second)
    assert given.poll_request().edition == edition


def test_nobody_knows_what_a_datagram_s_sender_has_heard():
    given, (made, talk) = bridge("all"), ends()
    octets = function("joystick", "halt", count=0)
    for now_ns in (S, 3 * S):
        made[Segment.GROUND].handle_request(passed(given, octets), now_ns)
        seen, asked = talk(now_ns)
        for packet in seen[Segment.GROUND]:
            given.handle_telemetry(packet)
        assert len(asked) == (now_ns == S)


class Batches:
    """A reader of samples of frames, by number."""

    def __init__(self, *numbers):
        self._numbers = [*numbers]

    def next(self):
        if not self._numbers:
            return None
        number = self._numbers.pop(0)
        octets = pack_frames([(0, b"one %d" % number), (1, b"two %d" % number)])
        lease = MagicMock(stamp=SimpleNamespace(sequence=number))
        lease.octets.return_value = octets
        return lease


def test_each_frame_is_a_datagram_and_missed_samples_are_counted():
    sent = []
    copies = FrameCopies(Batches(4, 5, 8, 0, 1), SimpleNamespace(send=sent.append))
    copies.copy()
    assert sent[:3] == [b"one 4", b"two 4", b"one 5"]
    assert copies.copied == len(sent) == 10
    # After 8 a gateway was started again.
    assert copies.missed == 2


@pytest.mark.parametrize("text", ["127.0.0.1:5", "tcp:5", "udp:5", "udp:a:0", "udp:a:65535"])
def test_frames_go_by_udp_to_two_ports(text):
    assert parse_frames("udp:127.0.0.1:5") == ("127.0.0.1", 5)
    with pytest.raises(ConfigError, match=r"--frames .* write udp:HOST:PORT"):
        parse_frames(text)


def test_yamcs_takes_each_virtual_channel_of_both_ways():
    def links(frames_port):
        files = instance_files("", ("here", 5), udp=False, frames_port=frames_port, http_port=8090)
        return files["etc/yamcs.kontur_av.yaml"].split("  - name: session")[1]

    assert "UdpTmFrameLink" not in links(None)
    down, up = links(7).split("  - name: ")[1:]
    for text, values in (
        (down, {"port": ["7"], "spacecraftId": ["76"], "frameLength": ["500"], "vcId": ["1"]}),
        (up, {"port": ["8"], "frameLength": ["32"], "vcId": [str(one) for one in range(32)]}),
    ):
        for name, expected in values.items():
            assert re.findall(rf"{name}: (\w+)", text) == expected
