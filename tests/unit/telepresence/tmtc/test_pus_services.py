"""PUS services, end to end on virtual time: an application in space and its user on the ground."""

from math import nan

import pytest
from pus_ends import MS, Ends, S, oven, oven_table

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus.dictionary_file import dictionary_from_table
from telepresence.tmtc.pus.monitoring import LimitMonitors
from telepresence.tmtc.pus.node import PusNode
from telepresence.tmtc.pus.packets import Telecommand, pack_packet, parse_packet
from telepresence.tmtc.pus.user import (
    Alive,
    CommandProgress,
    CommandResult,
    EventReport,
    HousekeepingReport,
    ParameterReport,
)
from telepresence.tmtc.pus.verification import (
    MOST_REASON,
    Failure,
    VerificationStage,
    pack_verification,
    parse_verification,
    verification_of,
)

HOT = {"temperature": 230.0, "door": "closed"}


def results(ends: Ends) -> list[CommandResult]:
    return [event for event in ends.events() if isinstance(event, CommandResult)]


def test_a_function_is_accepted_started_and_completed() -> None:
    ends = Ends()
    number = ends.user.call("oven", "heat", [180.5], now_ns=0)
    ends.step()
    assert ends.calls == [("FunctionRequest", ("heat", (180.5,)))]
    assert ends.events() == [
        CommandProgress(number, "oven", VerificationStage.ACCEPTED),
        CommandProgress(number, "oven", VerificationStage.STARTED),
        CommandResult(number, "oven", True, True, "", 0, 1),
    ]


def test_a_refused_function_says_why() -> None:
    ends = Ends()
    ends.refusal = "the door is open"
    ends.user.call("oven", "off", now_ns=0)
    ends.step()
    assert [(one.ok, one.reason) for one in results(ends)] == [(False, "the door is open")]
    assert (ends.oven.executed, ends.oven.failed) == (0, 1)


def test_a_lost_verification_is_asked_for_again_and_nothing_is_done_twice() -> None:
    ends = Ends()
    ends.user.call("oven", "off", now_ns=0)
    ends.down = False
    ends.run(1 * S)
    assert len(ends.calls) == 1
    ends.down = True
    ends.run(2 * S)
    assert [(one.ok, one.tries) for one in results(ends)] == [(True, 3)]
    assert (len(ends.calls), ends.oven.executed, ends.oven.duplicates) == (1, 1, 2)


def test_a_reason_is_cut_to_what_a_report_carries_and_a_longer_one_is_garbage() -> None:
    command = Telecommand(apid=0x200, count=1, service=8, subtype=1, data=b"")
    report = verification_of(
        command, VerificationStage.STARTED, Failure.REFUSED, (MOST_REASON + 1) * "x"
    )
    data = pack_verification(report)
    assert parse_verification(report.subtype, data) == report
    assert report.reason == MOST_REASON * "x"
    with pytest.raises(ProtocolError):
        parse_verification(report.subtype, data + b"x")


def test_one_dead_direction_ends_without_verification_but_the_command_is_carried_out() -> None:
    ends = Ends()
    ends.user.call("oven", "off", now_ns=0)
    ends.down = False
    ends.run(40 * S)
    (result,) = results(ends)
    assert (result.ok, result.verified, result.reason) == (False, False, "no verification came")
    assert len(ends.calls) == 1


def test_a_restarted_user_is_not_taken_for_a_repetition() -> None:
    ends, again = Ends(first_count=100), Ends(first_count=101)
    for user in (ends.user, again.user):
        user.call("oven", "off", now_ns=0)
        octets = user.poll_transmit(0)
        assert octets is not None
        ends.space.handle_packet(octets, 0)
    assert (ends.oven.duplicates, len(list(iter(ends.oven.next_event, None)))) == (0, 2)


def test_an_unknown_application_is_a_failure_of_routing() -> None:
    user = Ends().user
    user.ping("oven", now_ns=0)
    empty = PusNode(rate_bps=10_000)
    octets = user.poll_transmit(0)
    assert octets is not None
    empty.handle_packet(octets, 0)
    answer = parse_packet(empty.poll_transmit(0) or b"")
    user.handle_telemetry(answer, 0)  # type: ignore[arg-type]
    event = user.next_event()
    assert isinstance(event, CommandResult)
    assert event.reason == "no application 512 at this end"


@pytest.mark.parametrize(
    ("service", "subtype", "data", "reason"),
    [
        (8, 1, b"", "no such function"),
        (8, 1, b"\x09", "no such function"),
        (8, 1, b"\x01\x00", "1 octets for 1 parameters"),
        (3, 27, b"\x01\x09", "no structure 9"),
        (3, 27, b"\x02\x01", "no list of numbers"),
        (9, 1, b"", "9,1 is unknown to oven"),
        (20, 3, b"\x01\x03\x00", "target is cut off"),
        (20, 3, b"\x01\x01\x00\x00\x00\x00", "temperature cannot be set"),
        (20, 3, b"\x01\x03\xff\xff", "target is 32767.5: give at most 250"),
        (8, 1, b"\x01\xff\xff", "target is 32767.5: give at most 250"),
        (17, 1, b"\x00", "are-you-alive has no data"),
        (12, 2, b"\x01\x05", "no monitor 5"),
        (19, 5, b"\x01\x02", "no event with an action 2"),
    ],
)
def test_what_cannot_be_done_is_answered_by_a_reason(
    service: int, subtype: int, data: bytes, reason: str
) -> None:
    ends = Ends()
    command = Telecommand(
        apid=0x200, count=1, service=service, subtype=subtype, data=data, source=7
    )
    ends.space.handle_packet(pack_packet(command), 0)
    reports = [parse_packet(octets) for octets in iter(lambda: ends.space.poll_transmit(0), None)]
    assert reports[-1].subtype in (2, 8)
    assert reason.encode() in reports[-1].data
    assert ends.oven.failed == 1


def test_housekeeping_comes_when_it_has_values_and_then_at_its_interval() -> None:
    ends = Ends()
    ends.run(2500 * MS)
    assert ends.events() == []
    ends.oven.handle_values({"temperature": 20.0, "door": "open"}, ends.now_ns)
    ends.run(5400 * MS)
    reports = ends.events()
    assert [report.unix_ns for report in reports] == [2500 * MS, 3500 * MS, 4500 * MS]
    assert reports[0] == HousekeepingReport(
        "oven", "state", {"temperature": 20.0, "door": "open"}, 2500 * MS
    )


def test_housekeeping_that_went_out_without_a_signal_comes_again_with_one() -> None:
    ends = Ends()
    ends.oven.handle_values({"temperature": 20.0, "door": "open"}, 0)
    # A signal that comes and goes between two reports adds none.
    for at_ms, signal in ((300, True), (400, False), (500, True), (1200, False), (1700, True)):
        ends.run(at_ms * MS)
        ends.oven.handle_signal(signal, ends.now_ns)
    ends.run(2000 * MS)
    assert [round(report.unix_ns / MS) for report in ends.events()] == [0, 300, 1300, 1700]


def test_housekeeping_is_switched_and_asked_for_once() -> None:
    ends = Ends()
    ends.oven.handle_values({"temperature": 20.0, "door": "open", "lit": True}, 0)
    ends.user.switch_housekeeping("oven", "state", on=False, now_ns=0)
    ends.user.request_housekeeping("oven", "light", now_ns=0)
    ends.run(3 * S)
    reports = [event for event in ends.events() if isinstance(event, HousekeepingReport)]
    assert [(report.structure, dict(report.values)) for report in reports] == [
        ("light", {"lit": True})
    ]
    ends.user.switch_housekeeping("oven", "light", on=True, now_ns=ends.now_ns)
    ends.run(5500 * MS)
    reports = [event for event in ends.events() if isinstance(event, HousekeepingReport)]
    assert len(reports) == 3


def test_a_limit_reports_an_event_that_starts_a_function() -> None:
    ends = Ends()
    for temperature in (230.0, 150.0, 230.0, nan, 230.0, 230.0, 190.0, 150.0, 150.0):
        ends.oven.handle_values({"temperature": temperature}, ends.now_ns)
        ends.step()
    assert ends.calls == [("FunctionRequest", ("off", ()))]
    events = [event for event in ends.events() if isinstance(event, EventReport)]
    assert [(event.event, event.severity) for event in events] == [
        ("too_hot", "high"),
        ("cooled", "info"),
    ]
    assert events[0].values == {"temperature": 230.0}


def test_rules_and_events_are_switched_by_telecommand() -> None:
    ends = Ends()
    commands = ((5, 6, b"\x01\x01"), (19, 5, b"\x01\x01"))
    for count, (service, subtype, data) in enumerate(commands):
        command = Telecommand(apid=0x200, count=count, service=service, subtype=subtype, data=data)
        ends.space.handle_packet(pack_packet(command), 0)
    for _ in range(3):
        ends.oven.handle_values(HOT, 0)
    ends.step()
    assert (ends.calls, ends.oven.events_reported) == ([], 0)


def test_are_you_alive_and_parameters() -> None:
    ends = Ends()
    ends.user.ping("oven", now_ns=0)
    ends.user.set_parameters("oven", {"target": 99.5}, now_ns=0)
    ends.user.request_parameters("oven", ["target"], now_ns=0)
    ends.step()
    assert ends.calls == [("ParameterSet", ("target", 99.5))]
    reports = [event for event in ends.events() if isinstance(event, Alive | ParameterReport)]
    assert reports == [Alive("oven", 0), ParameterReport("oven", {"target": 99.5}, 0)]


def test_the_bucket_bounds_what_is_sent_and_waiting_housekeeping_stays_fresh() -> None:
    ends = Ends(rate_bps=100)
    ends.oven.handle_values({"temperature": 20.0, "door": "open"}, 0)
    ends.run(100 * S)
    assert ends.space.sent_octets <= 512 + 100 * 100 // 8
    # A report of 27 octets takes 2.16 s. No more than one waits.
    reports = [event for event in ends.events() if isinstance(event, HousekeepingReport)]
    assert 55 <= len(reports) <= 66
    assert ends.now_ns - reports[-1].unix_ns <= 5 * S
    assert ends.space.delayed > 0


def test_waiting_reports_and_open_commands_are_bounded() -> None:
    ends = Ends()
    for _ in range(200):
        ends.oven.handle_event("cooled", 0)
    assert ends.oven.dropped_reports == 136
    numbers = [ends.user.ping("oven", now_ns=0) for _ in range(17)]
    assert numbers == [*range(16), None]


def test_unknown_names_and_unfit_values_are_refused() -> None:
    user = Ends().user
    with pytest.raises(ConfigError, match="application 'stove' is unknown: choose one of oven"):
        user.ping("stove", now_ns=0)
    with pytest.raises(ConfigError, match="no function 'cook': choose one of heat, off"):
        user.call("oven", "cook", now_ns=0)
    with pytest.raises(ConfigError, match="0 values: give target"):
        user.call("oven", "heat", now_ns=0)
    with pytest.raises(ConfigError, match="door is 'ajar': choose one of open, closed"):
        oven().application("oven").parameter("door").pack("ajar")


def test_limits_are_left_for_a_while_and_a_value_on_them_is_within() -> None:
    table = oven_table()
    table["oven"]["event"]["cold"] = {"number": 3, "severity": "low"}
    table["oven"]["monitor"]["heat"].update(low=10.0, low_clear=20.0, below="cold")
    monitors = LimitMonitors(dictionary_from_table(table).application("oven"))

    def check(*values: float) -> list[list[str]]:
        return [monitors.handle_values({"temperature": value}) for value in values]

    assert check(10.0, 10.0, 220.0, 220.0) == [[]] * 4
    assert check(9.9, 9.9, 15.0, 15.0, 20.0, 20.0) == [[], ["cold"], [], [], [], ["cooled"]]
    assert check(220.1, 230.0, 200.0, 200.0, 180.0, 180.0) == [
        [],
        ["too_hot"],
        *[[]] * 3,
        ["cooled"],
    ]
    # Each event needs its checks in a row.
    assert check(230.0, 100.0, 230.0, 230.0) == [[], [], [], ["too_hot"]]
    # A monitor that is switched on again begins within its limits.
    monitors.set_on(1, on=False)
    assert check(100.0, 100.0) == [[], []]
    monitors.set_on(1, on=True)
    assert check(230.0, 230.0) == [[], ["too_hot"]]
