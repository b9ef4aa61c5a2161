"""What another ground system may send, how fast, and what it gets."""

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import CommandUpdate, FunctionAsked, FunctionDone
from pipelines.packets import bridge as bridges
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus import verification
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, pack_packet, parse_packet
from telepresence.tmtc.pus.verification import Failure, VerificationStage

DICTIONARY = built_in_dictionary()
S = 1_000_000_000


def command(application, service, subtype, data=b"", count=5):
    values = {"service": service, "subtype": subtype, "data": data, "count": count}
    return pack_packet(Telecommand(apid=DICTIONARY.application(application).apid, **values))


def function(application, name, count=5):
    number = DICTIONARY.application(application).function(name).number
    return command(application, 8, 1, bytes([number]), count)


def bridge(*words):
    allowed = bridges.allowed_commands(words, DICTIONARY)
    return bridges.PacketBridge(DICTIONARY, allowed, client="it", source=3, epoch_ns=0)


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
    for word, fix in (("oven", "joystick"), ("robot.fly", "power_on"), ("camera.", "select")):
        with pytest.raises(ConfigError, match=fix):
            bridge(word)


def test_what_is_not_allowed_or_refused_by_the_end_is_reported():
    given = bridge()
    given.handle_command(function("robot", "power_on", count=9), 7 * S)
    report = parse_packet(given.poll_report())
    assert (report.service, report.destination, report.cuc) == (1, 3, 7 << 16)
    about = verification.parse_verification(report.subtype, report.data)
    assert (about.apid, about.count, about.failure) == (0x131, 9, Failure.REFUSED)
    assert given.metrics.outside_refused == 1
    assert given.poll_report() is None
    given = bridge("all")
    request = passed(given, function("robot", "power_on", count=4))
    told = CommandUpdate("it", request.id, "robot", "refused", done=True, reason="too many")
    given.handle_news(told, 0)
    report = parse_packet(given.poll_report())
    about = verification.parse_verification(report.subtype, report.data)
    assert (about.count, about.reason) == (4, "too many")


def test_a_flood_is_dropped_a_stream_is_split_and_a_slow_peer_loses_no_half_packet():
    given = bridge()
    for octets in (b"nonsense", bytes.fromhex("093300000012")):
        given.handle_command(octets, 0)
    for number in range(100):
        given.handle_command(command("robot", 17, 1, count=number), 0)
    assert given.metrics.outside_garbage == 2
    assert given.metrics.outside_excess == 102 - bridges.COMMANDS_AT_ONCE
    given.handle_command(command("robot", 17, 1, count=200), S)
    assert given.metrics.outside_excess == 102 - bridges.COMMANDS_AT_ONCE
    first, second = command("robot", 17, 1), function("joystick", "halt")
    splitter = bridges.PacketSplitter()
    parts = [splitter.handle_octets(bytes([octet])) for octet in first + second]
    assert [one for found in parts for one in found] == [first, second]
    with pytest.raises(ProtocolError):
        splitter.handle_octets(b"GET / HTTP/1.1\r\n")
    queue = bridges.PeerQueue()
    queue.put(b"first", 0)
    queue.handle_written(2, 0)
    for number in range(bridges.PeerQueue.DEPTH):
        queue.put(bytes([number]), 1)
    assert queue.dropped == 1
    assert queue.octets == b"rst"
    queue.handle_written(3, 5)
    assert queue.max_age_ns == 5
    assert queue.octets == bytes([1])


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({}, 0),
        ({0: {"heard_ns": 1}}, 1),
        ({5: {"taken_ns": 10 * S}}, 5),
        ({5: {"taken_ns": 26 * S}}, 0),
        ({5: {"taken_ns": 10 * S}, 6: {"taken_ns": 9 * S}, 0: {"heard_ns": 9}}, 6),
        ({5: {"taken_ns": 10 * S}, 3: {"sends": False, "heard_ns": 29 * S}}, 3),
        ({number: {"heard_ns": 90 - number} for number in range(8)}, 7),
    ],
)
def test_of_eight_peers_that_one_gives_way_which_is_most_likely_gone(changed, named):
    queues = {number: bridges.PeerQueue(30 * S) for number in range(8)}
    for number, fields in changed.items():
        for name, value in fields.items():
            setattr(queues[number], name, value)
    assert min(queues, key=lambda one: queues[one].rank(30 * S)) == named


class Ends:
    """Both ends."""

    def __init__(self):
        self.ends = {
            one: TmtcEnd(one, DICTIONARY, now_ns=0, first_count=5, boot_id=1) for one in Segment
        }
        self.ground = self.ends[Segment.GROUND]

    def talk(self, now_ns):
        """Let them talk; return the packets on the ground, and what was asked for."""
        local, asked = {one: [] for one in Segment}, []
        for _ in range(4):
            for segment, end in self.ends.items():
                for packet in iter(lambda end=end: end.poll_transmit(now_ns), None):
                    self.ends[segment.peer].handle_packet(packet, now_ns)
                    local[segment.peer].append(packet)
                local[segment] += iter(end.next_local, None)
                for news in iter(end.next_event, None):
                    if isinstance(news, FunctionAsked):
                        asked.append((news.application, news.function))
                        end.handle_request(FunctionDone(news.application, news.token), now_ns)
        return local[Segment.GROUND], asked


def stages(packets):
    """Of the verification for source 3, in any edition."""
    reports = [one for one in map(parse_packet, packets) if one.service == 1]
    assert {report.destination % 256 for report in reports} <= {3}
    return [report.subtype for report in reports]


@pytest.mark.parametrize(("application", "name"), [("joystick", "halt"), ("robot", "power_off")])
def test_a_foreign_telecommand_is_carried_out_and_verified_at_either_end(application, name):
    given, both = bridge("all"), Ends()
    # The own user's telecommand of the same count is another one.
    both.ground.handle_request(passed(given, function(application, name, count=5)), 0)
    seen, asked = both.talk(0)
    assert (asked, stages(seen)) == ([(application, name)], [1, 3, 7])
    # It has ended: nothing is repeated.
    assert not both.talk(20 * S)[1]


def test_foreign_telecommands_leave_room_for_the_own_user():
    given, ground = bridge("all"), Ends().ground
    for number in range(6):
        ground.handle_request(passed(given, function("joystick", "halt", count=number)), 0)
    ground.poll_transmit(0)
    told = [news.stage for news in iter(ground.next_event, None)]
    assert (told.count("taken"), told.count("refused")) == (4, 2)

    # Nobody knows what a datagram's sender has heard.
    given, both = bridge("all"), Ends()
    octets = function("joystick", "halt", count=0)
    for now_ns in (S, 3 * S):
        both.ground.handle_request(passed(given, octets), now_ns)
        seen, asked = both.talk(now_ns)
        for packet in seen:
            given.handle_telemetry(packet)
        assert len(asked) == (now_ns == S)


@pytest.mark.parametrize(("application", "name"), [("joystick", "halt"), ("robot", "power_off")])
def test_a_system_that_began_anew_is_heeded_and_a_repetition_is_not(application, name):
    """Its counts begin anew, too, so its telecommands are octet by octet those of before."""
    given, both, now_ns = bridge("all"), Ends(), 0
    octets = function(application, name, count=0)

    def carried_out(connection, *, told=True):
        nonlocal now_ns
        now_ns += S
        given.handle_command(octets, now_ns, connection)
        both.ground.handle_request(given.poll_request(), now_ns)
        given.handle_sent()
        seen, asked = both.talk(now_ns)
        for packet in seen if told else ():
            given.handle_telemetry(packet)
        assert stages(seen) == [1, 3, 7]
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
    ("stage", "source", "edition"),
    [("STARTED", 3, 0), ("COMPLETED", 4, 0), ("COMPLETED", 3, 1), ("ACCEPTED", 3, 1)],
)
def test_only_the_report_of_its_end_makes_room_for_an_equal_telecommand(stage, source, edition):
    failure = Failure.BAD_DATA if stage == "ACCEPTED" else None
    given, octets = bridge("all"), function("robot", "power_off")
    first, second = given.handle_connection(), given.handle_connection()
    given.handle_command(octets, 0, first)
    given.handle_sent()
    command = parse_packet(octets)
    report = verification.verification_of(command, VerificationStage[stage], failure, "no")
    given.handle_telemetry(
        verification.pack_refusal(command, report, count=0, destination=source, unix_ns=0)
    )
    given.handle_heard(first)
    given.handle_command(octets, S, second)
    assert given.poll_request().edition == edition
