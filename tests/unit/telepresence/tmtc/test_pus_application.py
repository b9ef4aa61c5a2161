"""An application of PUS: what it remembers, what it bounds, and what its reports say."""

from dataclasses import replace

import pytest
from pus_ends import MS, S, oven, oven_table

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus.application import FunctionRequest, ParameterSet, PusApplication
from telepresence.tmtc.pus.dictionary_file import dictionary_from_table
from telepresence.tmtc.pus.head import (
    apid_of,
    destination_of,
    is_packet,
    is_telecommand,
    message_of,
)
from telepresence.tmtc.pus.packets import Telecommand, ns_from_cuc, pack_packet, parse_packet
from telepresence.tmtc.pus.verification import (
    MOST_REASON,
    VerificationStage,
    parse_verification,
    verification_of,
)

OVEN = oven().application("oven")


def command(service=17, subtype=1, data=b"", count=1, **fields):
    values = {"apid": 0x200, "source": 7} | fields
    return Telecommand(count=count, service=service, subtype=subtype, data=data, **values)


def reports(application, now_ns=0):
    return [parse_packet(one) for one in iter(lambda: application.poll_transmit(now_ns), None)]


def answer(application, request, now_ns=0):
    application.handle_telecommand(request, now_ns)
    return reports(application, now_ns)


def requests(application):
    return list(iter(application.next_event, None))


@pytest.mark.parametrize(
    ("flags", "subtypes"), [(0, []), (8, [1]), (4, [3]), (2, []), (1, [7]), (15, [1, 3, 7])]
)
def test_successes_are_reported_as_far_as_the_flags_ask_and_failures_always(flags, subtypes):
    """ECSS-E-ST-70-41C clause 8.2.1: acceptance 8, start 4, progress 2, completion 1."""
    application = PusApplication(OVEN, now_ns=0)
    found = answer(application, command(12, 1, b"\1\1", flags=flags))
    assert [(one.service, one.subtype) for one in found] == [(1, one) for one in subtypes]
    assert all((one.destination, one.data) == (7, bytes.fromhex("1a00c001")) for one in found)
    (failure,) = answer(application, command(9, 9, count=2, flags=0))
    assert failure.subtype == 2
    assert (application.executed, application.failed) == (1, 1)


@pytest.mark.parametrize(
    ("request_", "subtype", "code"),
    [
        (command(9, 1), 2, 2),
        (command(8, 1), 2, 3),
        (command(20, 1, b"\1\1"), 8, 4),
        (command(3, 27, b"\1\1"), 8, 4),
        (command(20, 3, b""), 2, 3),
        (command(20, 3, b"\0"), 2, 3),
        (command(20, 3, b"\1\3\0\1\0"), 2, 3),
        (command(20, 3, b"\1\x63\0"), 2, 3),
        (command(3, 5, b""), 2, 3),
        (command(3, 5, b"\0"), 2, 3),
        (command(3, 5, b"\1\1\1"), 2, 3),
        (command(5, 5, b"\1\3"), 2, 3),
    ],
)
def test_a_failure_has_its_stage_and_code(request_, subtype, code):
    found = answer(PusApplication(OVEN, now_ns=0), request_)
    assert (found[-1].subtype, found[-1].data[4]) == (subtype, code)


def test_no_more_than_16_functions_are_in_progress():
    application = PusApplication(OVEN, now_ns=0)
    for count in range(16):
        assert answer(application, command(8, 1, b"\2", count))[-1].subtype == 3
    (refusal,) = answer(application, command(8, 1, b"\2", 16))
    assert (refusal.subtype, refusal.data[4:]) == (2, b"\x0516 functions are in progress")
    tokens = [one.token for one in requests(application)]
    assert len(set(tokens)) == 16
    for token in (None, 99, tokens[3], tokens[3]):
        application.handle_result(token, "", 0)
    (done,) = reports(application)
    assert (done.subtype, done.data) == (7, bytes.fromhex("1a00c003"))
    assert application.executed == 1
    assert answer(application, command(8, 1, b"\2", 17))[-1].subtype == 3


def test_a_repetition_is_known_for_a_minute_and_among_64():
    application = PusApplication(OVEN, now_ns=0)
    first = command(8, 1, b"\2")
    for now_ns, carried_out in ((0, 1), (60 * S, 0), (60 * S + 1, 1), (61 * S, 0)):
        found = answer(application, first, now_ns)
        assert [one.subtype for one in found] == [1, 3]
        assert len(requests(application)) == carried_out
    assert application.duplicates == 2
    for count in range(2, 65):
        application.handle_telecommand(command(17, 1, b"", count), 62 * S)
    application.handle_telecommand(first, 62 * S)
    assert (application.duplicates, requests(application)) == (3, [])
    application.handle_telecommand(command(17, 1, b"", 65), 62 * S)
    application.handle_telecommand(first, 62 * S)
    assert application.duplicates == 3
    assert requests(application) == [FunctionRequest(2, "off", ())]


def test_packets_have_counts_of_the_application_and_of_each_message():
    application = PusApplication(OVEN, now_ns=0, epoch_ns=5 * S, first_count=(1 << 14) - 1)
    application.handle_event("cooled", S)
    application.handle_telecommand(command(), 2 * S)
    application.handle_event("cooled", 3 * S)
    found = reports(application, 4 * S)
    assert [(one.service, one.subtype, one.count, one.counter) for one in found] == [
        (5, 1, 16_383, 0),
        (17, 2, 0, 0),
        (1, 1, 1, 0),
        (1, 3, 2, 0),
        (1, 7, 3, 0),
        (5, 1, 4, 1),
    ]
    # Each is dated when it was made. Events are for everybody.
    assert [(ns_from_cuc(one.cuc) // S, one.destination) for one in found] == [
        (6, 0), (7, 7), (7, 7), (7, 7), (7, 7), (8, 0),
    ]  # fmt: skip


def test_parameters_are_asked_for_and_set_together():
    application = PusApplication(OVEN, now_ns=0)
    application.handle_values({"depth": -2, "lit": True}, 0)
    *_, report, _, _, _ = answer(application, command(20, 1, b"\2\5\4"))
    assert (report.service, report.subtype, report.destination) == (20, 2, 7)
    assert report.data == bytes.fromhex("02 05fffffffe 0401")
    application.handle_telecommand(command(20, 3, bytes.fromhex("02 030050 030052"), 2), 0)
    assert requests(application) == [ParameterSet("target", 40.0), ParameterSet("target", 41.0)]
    # Of several, one that cannot be set keeps the others from being set.
    reports(application)
    found = answer(application, command(20, 3, bytes.fromhex("02 030054 0400"), 3))
    assert b"lit cannot be set" in found[-1].data
    assert (requests(application), application.values["target"]) == ([], 41.0)


def test_a_report_of_parameters_fills_a_packet_at_most():
    application = PusApplication(OVEN, now_ns=0)
    application.handle_values({"target": 40.0}, 0)
    found = answer(application, command(20, 1, bytes([78] + [3] * 78)))
    assert len(pack_packet(found[0])) == 256
    found = answer(application, command(20, 1, bytes([79] + [3] * 79), 2))
    assert b"too many parameters" in found[-1].data


def test_an_event_without_its_arguments_is_not_reported_but_acted_on():
    application = PusApplication(OVEN, now_ns=0)
    application.handle_event("too_hot", 0)
    assert (reports(application), application.events_reported) == ([], 0)
    assert requests(application) == [FunctionRequest(None, "off", ())]
    application.handle_values({"temperature": 20.0}, 0)
    application.handle_event("too_hot", 0)
    (event,) = reports(application)
    assert (event.subtype, event.data) == (4, bytes.fromhex("01 41a00000"))


def test_switches_take_several_numbers_and_back():
    application = PusApplication(OVEN, now_ns=0)
    application.handle_values({"temperature": 20.0}, 0)

    def told(service, subtype, data):
        request = command(service, subtype, bytes([len(data), *data]), application.executed)
        assert answer(application, request)[-1].subtype == 7
        for name in ("cooled", "too_hot"):
            application.handle_event(name, 0)
        return [one.data[0] for one in reports(application)], len(requests(application))

    assert told(5, 6, [2]) == ([1], 1)
    assert told(5, 6, [1]) == ([], 1)
    assert told(5, 5, [2, 1]) == ([2, 1], 1)
    assert told(19, 5, [1]) == ([2, 1], 0)
    assert told(19, 4, [1]) == ([2, 1], 1)
    hot = {"temperature": 230.0}
    for subtype, events in ((2, 0), (1, 1)):
        answer(application, command(12, subtype, b"\1\1", application.executed))
        for _ in range(3):
            application.handle_values(hot, 0)
        assert len(reports(application)) == events


def test_values_must_fit_and_are_forgotten_when_they_are_told_no_more():
    application = PusApplication(replace(OVEN, fresh_s=5.0), now_ns=0)
    with pytest.raises(ConfigError, match="door is 'ajar'"):
        application.handle_values({"temperature": 20.0, "door": "ajar"}, 0)
    assert application.values == {}
    application.handle_values({"temperature": 20.0, "door": "open"}, 0)
    assert len(reports(application, 5 * S)) == 1
    assert reports(application, 6 * S) == []
    assert application.values == {}
    # Without such a limit they stay.
    application = PusApplication(OVEN, now_ns=0)
    application.handle_values({"temperature": 20.0, "door": "open"}, 0)
    assert len(reports(application, 3600 * S)) == 1


def test_first_reports_of_all_structures_go_out_50_ms_apart():
    table = oven_table()
    table["oven"]["structure"]["light"]["on"] = True
    table["stove"] = dict(table["oven"], apid=0x201)
    found = []
    for one in dictionary_from_table(table).applications:
        application = PusApplication(one, now_ns=0)
        application.handle_values({"temperature": 20.0, "door": "open", "lit": True}, 0)
        while (due_ns := application.poll_timeout()) < 900 * MS:
            found += [(due_ns // MS, each.data[0]) for each in reports(application, due_ns)]
        assert application.housekeeping_reported == 2
    assert found == [(0, 1), (50, 2), (200, 1), (250, 2)]


def test_a_missed_interval_is_not_made_up_for_and_each_switch_begins_anew():
    application = PusApplication(OVEN, now_ns=0)
    application.handle_values({"temperature": 20.0, "door": "open", "lit": True}, 0)
    sent_ms = []
    for at_ms in (0, 999, 1000, 3999, 4000, 4500, 5000):
        sent_ms += [at_ms for _ in reports(application, at_ms * MS)]
    assert sent_ms == [0, 1000, 3999, 4000, 5000]
    # One that is on already goes on; one that is switched on is due at once.
    application.handle_telecommand(command(3, 5, b"\2\1\2"), 5200 * MS)
    data = [one.data[0] for one in reports(application, 5200 * MS) if one.service == 3]
    assert data == [2]
    application.handle_telecommand(command(3, 6, b"\2\1\2", 2), 5300 * MS)
    assert application.poll_timeout() is None


def test_reasons_are_printable_ascii_of_100_characters():
    told = verification_of(command(), VerificationStage.STARTED, None, "~ \x7f\x1fé" + 100 * "x")
    assert told.reason == "~ ???" + (MOST_REASON - 5) * "x"
    assert MOST_REASON == 100


@pytest.mark.parametrize(
    ("subtype", "octets"),
    [
        (5, "1a00c001"),
        (9, "1a00c001"),
        (1, "1a00c0"),
        (1, "1a00c00104"),
        (2, "1a00c001"),
        (1, "0a00c001"),
        (1, "1a008001"),
        (8, "1a00c00100"),
        (8, "1a00c00106"),
        (8, "1a00c001041f"),
        (8, "1a00c001047f"),
    ],
)
def test_verifications_of_no_telecommand_or_reason_are_garbage(subtype, octets):
    with pytest.raises(ProtocolError):
        parse_verification(subtype, bytes.fromhex(octets))


@pytest.mark.parametrize("subtype", [2, 4, 8, 10])
def test_a_failure_may_be_of_any_stage_and_without_a_reason(subtype):
    found = parse_verification(subtype, bytes.fromhex("1fffffff05"))
    assert (found.apid, found.count, found.stage, found.subtype) == (
        *(0x7FF, 0x3FFF, subtype - 1),
        subtype,
    )
    assert parse_verification(subtype, bytes.fromhex("1a00c00104207e")).reason == " ~"


def test_the_head_of_a_packet_tells_what_it_is():
    ping = pack_packet(command(apid=0x123))
    report = pack_packet(answer(PusApplication(OVEN, now_ns=0), command(source=0x0102))[0])
    assert (len(ping), len(report)) == (13, 21)
    for octets, apid, message, is_command in (
        (ping, 0x123, (17, 1), True),
        (report, 0x200, (17, 2), False),
    ):
        assert is_packet(octets)
        assert (apid_of(octets), message_of(octets)) == (apid, message)
        assert is_telecommand(octets) is is_command
        for wrong in (octets[:-1], octets + b"\0", octets[:12]):
            assert not is_packet(wrong)
        for at, octet in ((0, octets[0] | 0x20), (0, octets[0] ^ 8), (2, octets[2] & 0x7F)):
            assert not is_packet(octets[:at] + bytes([octet]) + octets[at + 1 :])
    assert (destination_of(report), destination_of(report[:20])) == (0x0102, 0)
    longest = command(8, 1, bytes(243))
    assert is_packet(pack_packet(longest))
    octets = pack_packet(longest) + b"\0"
    assert not is_packet(octets[:4] + (250).to_bytes(2, "big") + octets[6:])
