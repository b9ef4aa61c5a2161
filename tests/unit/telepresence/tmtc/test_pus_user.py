"""The user of PUS: what it sends, repeats and gives up, and which reports it takes."""

import pytest
from pus_ends import MS, Ends, S, oven_table

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary_file import dictionary_from_table
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, parse_packet
from telepresence.tmtc.pus.user import (
    SUPERSEDED,
    CommandProgress,
    CommandResult,
    CommandUnanswered,
    PusUser,
)
from telepresence.tmtc.pus.verification import (
    Failure,
    Verification,
    VerificationStage,
    pack_verification,
)

ACCEPTED, STARTED, COMPLETED = (
    VerificationStage.ACCEPTED,
    VerificationStage.STARTED,
    VerificationStage.COMPLETED,
)


def make_user(**settings):
    table = oven_table()
    table["oven"]["function"]["off"]["newest"] = True
    table["stove"] = {"apid": 0x201, "function": {"off": {"number": 2, "newest": True}}}
    return PusUser(
        dictionary_from_table(table),
        **{"source": 7, "first_count": 16_383, "foreign": 3} | settings,
    )


def events(user):
    return list(iter(user.next_event, None))


def sent(user, now_ns=0):
    return [parse_packet(one) for one in iter(lambda: user.poll_transmit(now_ns), None)]


def verify(user, stage, *, count=16_383, to=7, failure=None, now_ns=0, reason=""):
    report = Verification(0x200, count, stage, failure, reason)
    data = pack_verification(report)
    packet = Telemetry(
        apid=0x200, count=0, service=1, subtype=report.subtype, data=data, destination=to
    )
    user.handle_telemetry(packet, now_ns)


def test_each_request_has_the_octets_of_its_service():
    user = make_user()
    user.call("oven", "heat", [40], now_ns=0)
    user.ping("stove", now_ns=0)
    user.request_housekeeping("oven", "light", now_ns=0)
    user.switch_housekeeping("oven", "light", on=True, now_ns=0)
    user.switch_housekeeping("oven", "light", on=False, now_ns=0)
    user.request_parameters("oven", ["depth", "lit"], now_ns=0)
    user.set_parameters("oven", {"target": 99.5, "lit": True}, now_ns=0)
    packets = sent(user)
    assert [(one.service, one.subtype, one.data.hex()) for one in packets] == [
        (8, 1, "010050"),
        (17, 1, ""),
        (3, 27, "0102"),
        (3, 5, "0102"),
        (3, 6, "0102"),
        (20, 1, "020504"),
        (20, 3, "020300c70401"),
    ]
    # Each application has a count of its own, of 14 bits.
    assert [one.count for one in packets] == [16_383, 16_383, 0, 1, 2, 3, 4]
    assert {(one.source, one.flags) for one in packets} == {(7, 15)}


def test_a_telecommand_fills_a_packet_at_most():
    user = make_user()
    user.request_parameters("oven", ["target"] * 242, now_ns=0)
    assert len(user.poll_transmit(0)) == 256
    with pytest.raises(ConfigError, match="244 octets: split it"):
        user.request_parameters("oven", ["target"] * 243, now_ns=0)


def test_a_later_call_of_a_function_that_supersedes_ends_the_earlier_one():
    user = make_user()
    ended = user.call("oven", "off", now_ns=0)
    others = [user.call("stove", "off", now_ns=0), user.call("oven", "heat", [1], now_ns=0)]
    others.append(user.request_parameters("oven", ["door", "lit"], now_ns=0))
    assert len(sent(user)) == 4
    again = user.call("oven", "off", now_ns=5 * MS)
    assert events(user) == [CommandResult(ended, "oven", False, False, SUPERSEDED, 5 * MS, 1)]
    assert again not in others
    # One that the other ground system sends does so, too.
    off = Telecommand(apid=0x200, count=9, service=8, subtype=1, data=b"\2")
    user.forward(Telecommand(apid=0x200, count=8, service=20, subtype=1, data=b"\2"), now_ns=6 * MS)
    user.forward(Telecommand(apid=0x200, count=8, service=8, subtype=1, data=b"\1"), now_ns=6 * MS)
    assert events(user) == []
    user.forward(off, now_ns=6 * MS)
    assert [(one.number, one.reason) for one in events(user)] == [(again, SUPERSEDED)]


def test_telecommands_of_the_other_ground_system_keep_their_count():
    user = make_user()
    asked = Telecommand(apid=0x200, count=5, service=17, subtype=1, source=99, flags=0)
    numbers = [user.forward(asked, edition=edition, now_ns=0) for edition in range(5)]
    assert numbers == [0, 1, 2, 3, None]
    assert [(one.count, one.source, one.flags) for one in sent(user)] == [
        (5, 256 * edition + 3, 15) for edition in range(4)
    ]
    assert [user.hears(number) for number in (7, 3, 259, 4, 0, 263)] == [
        *(True, True, True, False, False, False)
    ]
    verify(user, COMPLETED, count=5, to=259)
    assert [(one.number, one.ok) for one in events(user)] == [(1, True)]
    with pytest.raises(ConfigError, match="no application 515"):
        user.forward(Telecommand(apid=0x203, count=0, service=17, subtype=1), now_ns=0)
    alone = make_user(foreign=None)
    assert not alone.hears(3)
    with pytest.raises(ConfigError, match="no application 512"):
        alone.forward(asked, now_ns=0)


def test_no_more_than_16_telecommands_are_open_whoever_sends_them():
    user = make_user()
    for _ in range(16):
        user.ping("oven", now_ns=0)
    asked = Telecommand(apid=0x200, count=5, service=17, subtype=1)
    assert user.forward(asked, now_ns=0) is None


def test_progress_is_told_once_and_never_backwards():
    user = make_user()
    number = user.ping("oven", now_ns=0)
    verify(user, ACCEPTED)  # it was not sent yet
    assert (user.unexpected, events(user)) == (1, [])
    sent(user)
    for stage in (ACCEPTED, ACCEPTED, STARTED, ACCEPTED, STARTED):
        verify(user, stage)
    assert events(user) == [
        CommandProgress(number, "oven", ACCEPTED),
        CommandProgress(number, "oven", STARTED),
    ]
    verify(user, COMPLETED, to=8)  # another user's
    verify(user, COMPLETED, count=16_382)
    assert (user.unexpected, events(user)) == (2, [])
    verify(user, STARTED, failure=Failure.REFUSED, reason="hot", now_ns=9 * MS)
    assert events(user) == [CommandResult(number, "oven", False, True, "hot", 9 * MS, 1)]
    assert user.poll_timeout() is None


@pytest.mark.parametrize(
    ("stage", "reason"), [(None, "no verification came"), (STARTED, "its end was not verified")]
)
def test_what_is_not_verified_is_repeated_and_given_up_after_30_s(stage, reason):
    user = make_user(foreign=None)
    number = user.ping("oven", now_ns=0)
    sent(user)
    if stage is not None:
        verify(user, stage)
    found = []
    while (due_ns := user.poll_timeout()) is not None:
        again = sent(user, due_ns)
        assert sent(user, due_ns) == []
        found += [(due_ns // MS, len(again), one) for one in events(user)]
    # Each wait is twice the one before, up to eight times the first one.
    at_ms = (500, 1500, 3500, 7500, 11_500, 15_500, 19_500, 23_500, 27_500)
    assert [at for at, count, _ in found if count] == (list(at_ms) if stage is None else [500])
    told = [one for _, _, one in found if isinstance(one, CommandUnanswered)]
    tries = range(2, 11) if stage is None else ()
    assert told == [CommandUnanswered(number, "oven", count) for count in tries]
    result = CommandResult(number, "oven", False, False, reason, 31_500 * MS, 10)
    assert found[-1] == (31_500, 0, result)
    assert (user.sent, user.repeated) == (10, 9)


def test_a_new_contact_repeats_at_once_what_is_open():
    user = make_user()
    user.ping("oven", now_ns=0)
    sent(user)
    user.handle_contact(100 * MS)
    assert user.poll_timeout() == 100 * MS
    assert len(sent(user, 100 * MS)) == 1


@pytest.mark.parametrize(
    ("timeout_ns", "patience_ns", "fits"),
    [
        (1, 60 * S - 1, True),
        (5, 5, True),
        (0, S, False),
        (6, 5, False),
        (1, 60 * S, False),
    ],
)
def test_patience_is_at_least_the_timeout_and_below_a_minute(timeout_ns, patience_ns, fits):
    if fits:
        make_user(timeout_ns=timeout_ns, patience_ns=patience_ns)
        return
    with pytest.raises(ConfigError, match="patience below 60 s"):
        make_user(timeout_ns=timeout_ns, patience_ns=patience_ns)


@pytest.mark.parametrize(
    ("service", "subtype", "data"),
    [
        (17, 2, "00"),
        (17, 1, ""),
        (20, 2, ""),
        (20, 2, "0109"),
        (3, 25, ""),
        (3, 25, "09"),
        (3, 25, "0201ff"),
        (5, 1, ""),
        (5, 1, "0141a00000"),  # its severity is high
        (5, 5, "02"),
        (5, 0, "02"),
        (5, 1, "0200"),
        (1, 5, "1a00c005"),
    ],
)
def test_reports_that_the_dictionary_does_not_know_are_garbage(service, subtype, data):
    user = make_user()
    packet = Telemetry(
        apid=0x200, count=0, service=service, subtype=subtype, data=bytes.fromhex(data)
    )
    user.handle_telemetry(packet, 0)
    assert (user.garbage, user.reports, user.unexpected, events(user)) == (1, 0, 0, [])


def test_reports_are_counted_and_of_unfetched_ones_the_oldest_goes():
    user = make_user()
    for count in range(257):
        alive = Telemetry(apid=0x200, count=count, service=17, subtype=2, cuc=count << 16)
        user.handle_telemetry(alive, 0)
    user.handle_telemetry(Telemetry(apid=0x202, count=0, service=17, subtype=2), 0)
    assert (user.reports, user.dropped_events, user.unexpected) == (257, 1, 1)
    assert [one.unix_ns // S for one in events(user)] == list(range(1, 257))


def test_events_of_each_severity_are_read():
    table = oven_table()
    severities = ("info", "low", "medium", "high")
    table["oven"]["event"] = {
        name: {"number": number, "severity": name} for number, name in enumerate(severities, 1)
    }
    table["oven"]["monitor"] = {}
    table["oven"]["action"] = []
    user = PusUser(dictionary_from_table(table), source=7, first_count=0)
    for number in range(1, 5):
        user.handle_telemetry(
            Telemetry(apid=0x200, count=0, service=5, subtype=number, data=bytes([number])), 0
        )
    assert [(one.event, one.severity) for one in events(user)] == [(one, one) for one in severities]


def test_a_result_tells_its_round_trip_and_how_often_it_was_sent():
    ends = Ends()
    ends.user.call("oven", "off", now_ns=0)
    ends.up = False
    ends.run(600 * MS)
    ends.up = True
    ends.run(2 * S)
    results = [one for one in ends.events() if isinstance(one, CommandResult)]
    assert [(one.round_trip_ns, one.tries) for one in results] == [(1500 * MS, 3)]
