"""The user of PUS: what it sends, repeats and gives up, and which reports it takes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pus_ends import (
    FATES,
    MS,
    Ends,
    LossyPath,
    S,
    command,
    events,
    oven,
    oven_table,
    packets,
    report,
    sent,
)

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus import user as pus_user
from telepresence.tmtc.pus.application import FunctionRequest, PusApplication
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary, dictionary_from_table
from telepresence.tmtc.pus.packets import parse_packet
from telepresence.tmtc.pus.user import CommandProgress, CommandResult, CommandUnanswered, PusUser
from telepresence.tmtc.pus.verification import (
    Failure,
    Verification,
    VerificationStage,
    pack_verification,
)

ACCEPTED, STARTED, COMPLETED, _ = VerificationStage


def make_user(**settings):
    table = oven_table()
    table["oven"]["function"]["off"]["newest"] = True
    table["stove"] = {"apid": 0x201, "function": {"off": {"number": 2, "newest": True}}}
    known = {"source": 7, "first_count": 16_383, "foreign": 3}
    return PusUser(dictionary_from_table(table), **known | settings)


def verify(user, stage, *, count=16_383, to=7, failure=None, now_ns=0, reason=""):
    told = Verification(0x200, count, stage, failure, reason)
    packet = report(1, told.subtype, pack_verification(told), destination=to)
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
    found = packets(user)
    assert [(one.service, one.subtype, one.data.hex()) for one in found] == [
        (8, 1, "010050"),
        (17, 1, ""),
        (3, 27, "0102"),
        (3, 5, "0102"),
        (3, 6, "0102"),
        (20, 1, "020504"),
        (20, 3, "020300c70401"),
    ]
    # Each application has a count of its own, of 14 bits.
    assert [one.count for one in found] == [16_383, 16_383, 0, 1, 2, 3, 4]
    assert {(one.source, one.flags) for one in found} == {(7, 15)}


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
    assert events(user) == [
        CommandResult(ended, "oven", False, False, pus_user.SUPERSEDED, 5 * MS, 1)
    ]
    assert again not in others
    # One that the other ground system sends does so, too.
    for service, data in ((20, b"\2"), (8, b"\1")):
        user.forward(command(service, 1, data, 8), now_ns=6 * MS)
    assert events(user) == []
    user.forward(command(8, 1, b"\2", 9), now_ns=6 * MS)
    assert [(one.number, one.reason) for one in events(user)] == [(again, pus_user.SUPERSEDED)]


def test_telecommands_of_the_other_ground_system_keep_their_count():
    user = make_user()
    asked = command(count=5, source=99, flags=0)
    numbers = [user.forward(asked, edition=edition, now_ns=0) for edition in range(5)]
    assert numbers == [0, 1, 2, 3, None]
    assert [(packet.count, packet.source, packet.flags) for packet in packets(user)] == [
        (5, 256 * edition + 3, 15) for edition in range(4)
    ]
    assert all(map(user.hears, (7, 3, 259))) and not any(map(user.hears, (4, 0, 263)))
    verify(user, COMPLETED, count=5, to=259)
    assert [(event.number, event.ok) for event in events(user)] == [(1, True)]
    with pytest.raises(ConfigError, match="no application 515"):
        user.forward(command(apid=0x203), now_ns=0)
    alone = make_user(foreign=None)
    assert not alone.hears(3)
    with pytest.raises(ConfigError, match="no application 512"):
        alone.forward(asked, now_ns=0)


def test_no_more_than_16_telecommands_are_open_whoever_sends_them():
    user = make_user()
    assert [user.ping("oven", now_ns=0) for _ in range(17)] == [*range(16), None]
    assert user.forward(command(count=5), now_ns=0) is None


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
        found += [(due_ns // MS, len(again), event) for event in events(user)]
    # Each wait is twice the one before, up to eight times the first one.
    at_ms = (500, 1500, 3500, 7500, 11_500, 15_500, 19_500, 23_500, 27_500)
    assert [at for at, count, _ in found if count] == (list(at_ms) if stage is None else [500])
    told = [one for _, _, one in found if isinstance(one, CommandUnanswered)]
    tries = range(2, 11) if stage is None else ()
    assert told == [CommandUnanswered(number, "oven", count) for count in tries]
    result = CommandResult(number, "oven", False, False, reason, 31_500 * MS, 10)
    assert found[-1] == (31_500, 0, result)
    assert (user.sent, user.repeated) == (10, 9)


def test_patience_is_at_least_the_timeout_and_below_a_minute():
    for timeout_ns, give_up_ns in ((1, 60 * S - 1), (5, 5)):
        make_user(timeout_ns=timeout_ns, give_up_ns=give_up_ns)
    for timeout_ns, give_up_ns in ((0, S), (6, 5), (1, 60 * S)):
        with pytest.raises(ConfigError, match="patience below 60 s"):
            make_user(timeout_ns=timeout_ns, give_up_ns=give_up_ns)


@pytest.mark.parametrize(
    ("service", "subtype", "data"),
    [
        (17, 2, "00"), (17, 1, ""), (20, 2, ""), (20, 2, "0109"), (3, 25, ""), (3, 25, "09"),
        (3, 25, "0201ff"), (5, 1, ""), (5, 5, "02"), (5, 0, "02"), (5, 1, "0200"),
        (1, 5, "1a00c005"),
        (5, 1, "0141a00000"),  # its severity is high
    ],
)  # fmt: skip
def test_reports_that_the_dictionary_does_not_know_are_garbage(service, subtype, data):
    user = make_user()
    user.handle_telemetry(report(service, subtype, bytes.fromhex(data)), 0)
    assert (user.garbage, user.reports, user.unexpected, events(user)) == (1, 0, 0, [])


def test_reports_are_counted_and_of_unfetched_ones_the_oldest_goes():
    user = make_user()
    for count in range(257):
        user.handle_telemetry(report(17, 2, count=count, cuc=count << 16), 0)
    user.handle_telemetry(report(17, 2, apid=0x202), 0)
    assert (user.reports, user.dropped_events, user.unexpected) == (257, 1, 1)
    assert [event.unix_ns // S for event in events(user)] == list(range(1, 257))


def test_each_request_is_answered_from_end_to_end():
    ends = Ends()
    heat = ends.user.call("oven", "heat", [180.5], now_ns=0)
    ends.step()
    assert ends.events() == [
        CommandProgress(heat, "oven", ACCEPTED),
        CommandProgress(heat, "oven", STARTED),
        CommandResult(heat, "oven", True, True, "", 0, 1),
    ]
    ends.refusal = "the door is open"
    ends.user.call("oven", "off", now_ns=0)
    ends.user.ping("oven", now_ns=0)
    ends.user.set_parameters("oven", {"target": 99.5}, now_ns=0)
    ends.user.request_parameters("oven", ["target"], now_ns=0)
    ends.oven.handle_values({"temperature": 20.0, "door": "open", "lit": True}, 0)
    ends.user.switch_housekeeping("oven", "state", on=False, now_ns=0)
    ends.user.request_housekeeping("oven", "light", now_ns=0)
    ends.run(3 * S)
    assert ends.calls == [
        ("FunctionRequest", ("heat", (180.5,))),
        ("FunctionRequest", ("off", ())),
        ("ParameterSet", ("target", 99.5)),
    ]
    told = [event for event in ends.events() if not isinstance(event, CommandProgress)]
    results = [one for one in told if isinstance(one, CommandResult)]
    assert [result.reason for result in results if not result.ok] == ["the door is open"]
    assert len(results) == 6
    light = pus_user.HousekeepingReport("oven", "light", {"lit": True}, 0)
    target = pus_user.ParameterReport("oven", {"target": 99.5}, 0)
    assert [one for one in told if one not in results] == [
        pus_user.Alive("oven", 0),
        target,
        light,
    ]
    ends.user.switch_housekeeping("oven", "light", on=True, now_ns=ends.now_ns)
    ends.run(5500 * MS)
    assert len(ends.events(pus_user.HousekeepingReport)) == 3


def test_unknown_names_and_unfit_values_are_refused():
    user = make_user()
    with pytest.raises(ConfigError, match="application 'stive' is unknown: choose one of oven"):
        user.ping("stive", now_ns=0)
    with pytest.raises(ConfigError, match="no function 'cook': choose one of heat, off"):
        user.call("oven", "cook", now_ns=0)
    with pytest.raises(ConfigError, match="0 values: give target"):
        user.call("oven", "heat", now_ns=0)
    with pytest.raises(ConfigError, match="door is 'ajar': choose one of open, closed"):
        oven().application("oven").parameter("door").pack("ajar")


@given(there=FATES, back=FATES, restart=st.integers(0, 60))
def test_a_telecommand_is_carried_out_once_or_its_failure_is_reported(there, back, restart):
    table = built_in_dictionary().application("tasks")
    timing = {"timeout_ns": 100 * MS, "give_up_ns": 4 * S}
    user = PusUser(built_in_dictionary(), source=1, first_count=7, **timing)
    application = PusApplication(table, now_ns=0)
    up, down = LossyPath(there), LossyPath(back)
    done, results, lives = [], [], 1
    numbers = [user.call("tasks", "select", [task], now_ns=0) for task in range(3)]
    for step in range(200):
        now_ns = step * 50 * MS
        if step == restart and restart % 2:
            # It forgets what it has carried out.
            application, lives = PusApplication(table, now_ns=now_ns), 2
        for octets in up.arrivals(step):
            application.handle_telecommand(parse_packet(octets), now_ns)
        for request in events(application):
            if isinstance(request, FunctionRequest):
                done.append(request.arguments[0])
                application.handle_result(request.token, "", now_ns)
        for octets in sent(application, now_ns):
            down.put(octets, step)
        for octets in down.arrivals(step):
            user.handle_telemetry(parse_packet(octets), now_ns)
        for octets in sent(user, now_ns):
            up.put(octets, step)
        results += [event for event in events(user) if isinstance(event, CommandResult)]
        if user.poll_timeout() is None:
            break
    assert sorted(result.number for result in results) == numbers
    for result in results:
        assert result.ok <= done.count(result.number) <= lives
        assert result.verified or not result.ok
    assert user.poll_timeout() is None
