"""An application of PUS: what it remembers, what it bounds, and what its reports say."""

from dataclasses import replace
from math import nan

import pytest
from pus_ends import MS, Ends, S, command, events, oven, oven_table, packets

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.application import FunctionRequest, ParameterSet, PusApplication
from telepresence.tmtc.pus.dictionary_file import dictionary_from_table
from telepresence.tmtc.pus.packets import ns_from_cuc, pack_packet
from telepresence.tmtc.pus.user import EventReport, HousekeepingReport

OVEN = oven().application("oven")
COOL = {"temperature": 20.0, "door": "open"}


@pytest.fixture
def application():
    return PusApplication(OVEN, now_ns=0)


def answer(application, request, now_ns=0):
    application.handle_telecommand(request, now_ns)
    return packets(application, now_ns)


@pytest.mark.parametrize(
    ("flags", "subtypes"), [(0, []), (8, [1]), (4, [3]), (2, []), (1, [7]), (15, [1, 3, 7])]
)
def test_successes_are_reported_as_far_as_the_flags_ask_and_failures_always(
    application, flags, subtypes
):
    """ECSS-E-ST-70-41C clause 8.2.1: acceptance 8, start 4, progress 2, completion 1."""
    found = answer(application, command(12, 1, b"\1\1", flags=flags))
    assert [(one.service, one.subtype) for one in found] == [(1, one) for one in subtypes]
    assert all((one.destination, one.data) == (7, bytes.fromhex("1a00c001")) for one in found)
    (failure,) = answer(application, command(9, 9, count=2, flags=0))
    assert failure.subtype == 2
    assert (application.executed, application.failed) == (1, 1)


@pytest.mark.parametrize(
    ("service", "subtype", "data", "stage", "code", "reason"),
    [
        (9, 1, "", 2, 2, "9,1 is unknown to oven"),
        (8, 1, "", 2, 3, "no such function"),
        (8, 1, "09", 2, 3, "no such function"),
        (8, 1, "0100", 2, 3, "1 octets for 1 parameters"),
        (8, 1, "01ffff", 2, 3, "target is 32767.5: give at most 250"),
        (3, 27, "0109", 2, 3, "no structure 9"),
        (3, 27, "0201", 2, 3, "no list of numbers"),
        (3, 27, "0101", 8, 4, ""),
        (3, 5, "", 2, 3, "no list of numbers"),
        (3, 5, "00", 2, 3, "no list of numbers"),
        (3, 5, "010101", 2, 3, "no list of numbers"),
        (5, 5, "0103", 2, 3, ""),
        (12, 2, "0105", 2, 3, "no monitor 5"),
        (17, 1, "00", 2, 3, "are-you-alive has no data"),
        (19, 5, "0102", 2, 3, "no event with an action 2"),
        (20, 1, "0101", 8, 4, ""),
        (20, 3, "", 2, 3, ""),
        (20, 3, "00", 2, 3, ""),
        (20, 3, "0103000100", 2, 3, ""),
        (20, 3, "016300", 2, 3, ""),
        (20, 3, "010300", 2, 3, "target is cut off"),
        (20, 3, "010100000000", 8, 4, "temperature cannot be set"),
        (20, 3, "0103ffff", 2, 3, "target is 32767.5: give at most 250"),
    ],
)
def test_a_failure_has_its_stage_code_and_reason(
    application, service, subtype, data, stage, code, reason
):
    *_, found = answer(application, command(service, subtype, bytes.fromhex(data)))
    assert (found.subtype, found.data[4]) == (stage, code)
    assert reason.encode() in found.data
    assert application.failed == 1


def test_no_more_than_16_functions_are_in_progress(application):
    for count in range(16):
        assert answer(application, command(8, 1, b"\2", count))[-1].subtype == 3
    (refusal,) = answer(application, command(8, 1, b"\2", 16))
    assert (refusal.subtype, refusal.data[4:]) == (2, b"\x0516 functions are in progress")
    tokens = [event.token for event in events(application)]
    assert len(set(tokens)) == 16
    for token in (None, 99, tokens[3], tokens[3]):
        application.handle_result(token, "", 0)
    (done,) = packets(application)
    assert (done.subtype, done.data) == (7, bytes.fromhex("1a00c003"))
    assert application.executed == 1
    assert answer(application, command(8, 1, b"\2", 17))[-1].subtype == 3
    application.handle_result(tokens[5], "hot", 0)
    (failed,) = packets(application)
    assert (failed.subtype, failed.data[4:]) == (8, b"\x04hot")
    assert (application.executed, application.failed) == (1, 2)


def test_a_repetition_is_known_for_a_minute_and_among_64(application):
    first = command(8, 1, b"\2")
    for now_ns, carried_out in ((0, 1), (60 * S, 0), (60 * S + 1, 1), (61 * S, 0)):
        assert [one.subtype for one in answer(application, first, now_ns)] == [1, 3]
        assert len(events(application)) == carried_out
    assert application.duplicates == 2
    for count in range(2, 65):
        application.handle_telecommand(command(count=count), 62 * S)
    application.handle_telecommand(first, 62 * S)
    assert (application.duplicates, events(application)) == (3, [])
    application.handle_telecommand(command(count=65), 62 * S)
    application.handle_telecommand(first, 62 * S)
    assert application.duplicates == 3
    assert events(application) == [FunctionRequest(2, "off", (), 7)]


def test_packets_have_counts_of_the_application_and_of_each_message():
    application = PusApplication(OVEN, now_ns=0, epoch_ns=5 * S, first_count=(1 << 14) - 1)
    application.handle_event("cooled", S)
    application.handle_telecommand(command(), 2 * S)
    application.handle_event("cooled", 3 * S)
    found = packets(application, 4 * S)
    # Each is dated when it was made. Events are for everybody.
    assert [
        (one.service, one.subtype, one.count, one.counter, ns_from_cuc(one.cuc) // S)
        for one in found
    ] == [
        (5, 1, 16_383, 0, 6), (17, 2, 0, 0, 7), (1, 1, 1, 0, 7), (1, 3, 2, 0, 7),
        (1, 7, 3, 0, 7), (5, 1, 4, 1, 8),
    ]  # fmt: skip
    assert [one.destination for one in found] == [0, 7, 7, 7, 7, 0]


def test_waiting_reports_are_bounded(application):
    for _ in range(200):
        application.handle_event("cooled", 0)
    assert (application.dropped_reports, len(packets(application))) == (136, 64)


def test_parameters_are_asked_for_and_set_together(application):
    application.handle_values({"depth": -2, "lit": True}, 0)
    *_, report, _, _, _ = answer(application, command(20, 1, b"\2\5\4"))
    assert (report.service, report.subtype, report.destination) == (20, 2, 7)
    assert report.data == bytes.fromhex("02 05fffffffe 0401")
    application.handle_telecommand(command(20, 3, bytes.fromhex("02 030050 030052"), 2), 0)
    assert events(application) == [ParameterSet("target", 40.0), ParameterSet("target", 41.0)]
    # Of several, one that cannot be set keeps the others from being set.
    packets(application)
    found = answer(application, command(20, 3, bytes.fromhex("02 030054 0400"), 3))
    assert b"lit cannot be set" in found[-1].data
    assert (events(application), application.values["target"]) == ([], 41.0)


def test_a_report_of_parameters_fills_a_packet_at_most(application):
    application.handle_values({"target": 40.0}, 0)
    found = answer(application, command(20, 1, bytes([78] + [3] * 78)))
    assert len(pack_packet(found[0])) == 256
    found = answer(application, command(20, 1, bytes([79] + [3] * 79), 2))
    assert b"too many parameters" in found[-1].data


def test_an_event_without_its_arguments_is_not_reported_but_acted_on(application):
    application.handle_event("too_hot", 0)
    assert (packets(application), application.events_reported) == ([], 0)
    assert events(application) == [FunctionRequest(None, "off", ())]
    application.handle_values(COOL, 0)
    packets(application)
    application.handle_event("too_hot", 0)
    (event,) = packets(application)
    assert (event.subtype, event.data) == (4, bytes.fromhex("01 41a00000"))
    assert application.events_reported == 1


def test_switches_take_several_numbers_and_back(application):
    application.handle_values({"temperature": 20.0}, 0)

    def reported(service, subtype, data):
        request = command(service, subtype, bytes([len(data), *data]), application.executed)
        assert answer(application, request)[-1].subtype == 7
        for name in ("cooled", "too_hot"):
            application.handle_event(name, 0)
        return [packet.data[0] for packet in packets(application)], len(events(application))

    assert reported(5, 6, [2]) == ([1], 1)
    assert reported(5, 6, [1]) == ([], 1)
    assert reported(5, 5, [2, 1]) == ([2, 1], 1)
    assert reported(19, 5, [1]) == ([2, 1], 0)
    assert reported(19, 4, [1]) == ([2, 1], 1)
    for subtype, reports in ((2, 0), (1, 1)):
        answer(application, command(12, subtype, b"\1\1", application.executed))
        for _ in range(3):
            application.handle_values({"temperature": 230.0}, 0)
        assert len(packets(application)) == reports


def test_a_limit_reports_an_event_that_starts_a_function():
    ends = Ends()
    for temperature in (230.0, 150.0, 230.0, nan, 230.0, 230.0, 190.0, 150.0, 150.0):
        ends.oven.handle_values({"temperature": temperature}, ends.now_ns)
        ends.step()
    assert ends.calls == [("FunctionRequest", ("off", ()))]
    hot, cooled = ends.events(EventReport)
    assert (hot.event, hot.severity, hot.values) == ("too_hot", "high", {"temperature": 230.0})
    assert (cooled.event, cooled.severity) == ("cooled", "info")


def test_values_must_fit_and_are_forgotten_when_they_are_told_no_more():
    application = PusApplication(replace(OVEN, fresh_s=5.0), now_ns=0)
    with pytest.raises(ConfigError, match="door is 'ajar'"):
        application.handle_values(COOL | {"door": "ajar"}, 0)
    assert application.values == {}
    application.handle_values(COOL, 0)
    assert len(packets(application, 5 * S)) == 1
    assert (packets(application, 6 * S), application.values) == ([], {})
    # Without such a limit they stay.
    application = PusApplication(OVEN, now_ns=0)
    application.handle_values(COOL, 0)
    assert len(packets(application, 3600 * S)) == 1


def test_first_reports_of_all_structures_go_out_50_ms_apart():
    table = oven_table()
    table["oven"]["structure"]["light"]["on"] = True
    table["stove"] = dict(table["oven"], apid=0x201)
    found = []
    for one in dictionary_from_table(table).applications:
        application = PusApplication(one, now_ns=0)
        application.handle_values(COOL | {"lit": True}, 0)
        while (due_ns := application.poll_timeout()) < 900 * MS:
            found += [(due_ns // MS, each.data[0]) for each in packets(application, due_ns)]
        assert application.housekeeping_reported == 2
    assert found == [(0, 1), (50, 2), (200, 1), (250, 2)]


def test_a_missed_interval_is_not_made_up_for_and_each_switch_begins_anew(application):
    application.handle_values(COOL | {"lit": True}, 0)
    sent_ms = []
    for at_ms in (0, 999, 1000, 3999, 4000, 4500, 5000):
        sent_ms += [at_ms for _ in packets(application, at_ms * MS)]
    assert sent_ms == [0, 1000, 3999, 4000, 5000]
    # One that is on already goes on; one that is switched on is due at once.
    found = answer(application, command(3, 5, b"\2\1\2"), 5200 * MS)
    assert [one.data[0] for one in found if one.service == 3] == [2]
    application.handle_telecommand(command(3, 6, b"\2\1\2", 2), 5300 * MS)
    assert application.poll_timeout() is None


def test_housekeeping_begins_with_its_values_and_comes_again_with_the_signal():
    ends = Ends()
    ends.run(2500 * MS)
    assert ends.events() == []
    ends.oven.handle_values(COOL, ends.now_ns)
    # A signal that comes and goes between two reports adds none.
    for at_ms, signal in ((2800, True), (2900, False), (3000, True), (3700, False), (4200, True)):
        ends.run(at_ms * MS)
        ends.oven.handle_signal(signal, ends.now_ns)
    ends.run(4500 * MS)
    reports = ends.events()
    assert reports[0] == HousekeepingReport("oven", "state", COOL, 2500 * MS)
    assert [round(report.unix_ns / MS) for report in reports] == [2500, 2800, 3800, 4200]


def test_the_bucket_bounds_what_is_sent_and_waiting_housekeeping_stays_fresh():
    ends = Ends(rate_bps=100)
    ends.oven.handle_values(COOL, 0)
    ends.run(100 * S)
    assert ends.space.sent_octets <= 512 + 100 * 100 // 8
    # A report of 27 octets takes 2.16 s. No more than one waits.
    reports = ends.events(HousekeepingReport)
    assert 55 <= len(reports) <= 66
    assert ends.now_ns - reports[-1].unix_ns <= 5 * S
    assert ends.space.delayed > 0
