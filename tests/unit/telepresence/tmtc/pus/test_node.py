"""One end of the TM/TC flow: who gets a packet, whose turn it is, and what stays at this end."""

from dataclasses import replace

import pytest
from pus_ends import MS, S, command, events, oven, packets, sent

from kontur_av.errors import ConfigError
from telepresence.tmtc.k2aci import Arrived, Chat, ChatRole, Delivered, K2aciEndpoint
from telepresence.tmtc.pus.application import PusApplication
from telepresence.tmtc.pus.node import K2aciLink, PusNode
from telepresence.tmtc.pus.packets import ns_from_cuc, pack_packet, parse_packet
from telepresence.tmtc.pus.user import Alive, CommandResult, EventReport, PusUser

TALK = Chat(sender=ChatRole.OPERATOR, text="hello")


def talk(boot_id=1, apid=0x141, **settings):
    """K2ACI between the applications 0x141 and 0x142."""
    return K2aciLink(K2aciEndpoint(boot_id=boot_id, **settings), apid=apid, peer=0x283 - apid)


def make(**settings):
    return PusNode(**{"rate_bps": 1_000_000} | settings)


def application():
    return PusApplication(oven().application("oven"), now_ns=0)


def user(**settings):
    return PusUser(oven(), source=7, first_count=0, **settings)


def exchange(node, other, now_ns=0):
    octets = sent(node, now_ns)
    for one in octets:
        other.handle_packet(one, now_ns)
    return [parse_packet(one) for one in octets]


def test_k2aci_goes_from_one_application_to_its_peer():
    one, other = (make(k2aci=talk(boot_id, 0x140 + boot_id), epoch_ns=9 * S) for boot_id in (1, 2))
    for _ in range(2):
        one.k2aci.endpoint.send(TALK, 0)
    told = exchange(one, other, S)
    assert [
        (p.apid, p.destination, p.service, p.subtype, p.count, p.counter, ns_from_cuc(p.cuc) // S)
        for p in told
    ] == [(0x141, 0x142, 129, 1, count, count, 10) for count in range(2)]
    assert other.k2aci.endpoint.next_event() == Arrived(1, 0, TALK)
    assert {(p.apid, p.destination) for p in exchange(other, one, S)} == {(0x142, 0x141)}
    assert one.k2aci.endpoint.next_event() == Delivered(0, TALK, S)
    assert (one.sent, one.received, one.garbage) == (2, 2, 0)
    assert one.sent_octets == sum(21 + len(p.data) for p in told)
    with pytest.raises(ConfigError, match="two applications"):
        K2aciLink(one.k2aci.endpoint, apid=5, peer=5)


def test_k2aci_of_others_is_ignored_and_garbage_counted():
    one, other = make(k2aci=talk()), make(k2aci=talk(2, 0x142))
    one.k2aci.endpoint.send(TALK, 0)
    (packet,) = sent(one)
    for field in ({"apid": 9}, {"destination": 9}, {"service": 130}, {"subtype": 2}):
        other.handle_packet(pack_packet(replace(parse_packet(packet), **field)), 0)
    other.handle_packet(packet[:-1], 0)
    assert (other.received, other.garbage, other.k2aci.endpoint.arrived) == (4, 1, 0)
    # A user takes no K2ACI for a report of an application.
    asking = user()
    node = make(user=asking)
    node.handle_packet(packet, 0)
    assert (node.received, asking.unexpected, asking.garbage) == (1, 0, 0)
    assert node.poll_timeout(0) is None


def test_no_flood_of_k2aci_keeps_a_report_waiting_and_telecommands_go_first():
    reporting, asking = application(), user(foreign=None)
    node = make(applications=[reporting], k2aci=talk())
    node.handle_packet(pack_packet(command(apid=9)), 0)
    for _ in range(4):
        node.k2aci.endpoint.send(TALK, 0)
        reporting.handle_event("cooled", 0)
    assert [packet.service for packet in packets(node)] == [1, *[129, 5] * 4]
    node = make(user=asking, k2aci=node.k2aci)
    node.k2aci.endpoint.send(TALK, S)
    asking.ping("oven", now_ns=S)
    assert [packet.service for packet in packets(node, S)][:2] == [17, 129]


def test_a_failure_of_routing_names_the_telecommand_and_goes_to_its_source():
    node = make(epoch_ns=2 * S)
    for count in range(18):
        node.handle_packet(pack_packet(command(count=count, apid=9, source=5)), S)
    # As many as the bucket holds, and the others later. The newest 16 are kept.
    found = [packet for now_ns in (S, 2 * S) for packet in packets(node, now_ns)]
    assert [(one.count, one.counter) for one in found] == [(n, n) for n in range(2, 18)]
    first = found[0]
    assert (first.apid, first.service, first.subtype, first.destination) == (9, 1, 10, 5)
    assert first.data == bytes.fromhex("1809c002 01") + b"no application 9 at this end"
    assert ns_from_cuc(first.cuc) == 3 * S
    # Its user hears why.
    asking, empty = user(), make()
    asking.ping("oven", now_ns=0)
    exchange(asking, empty)
    exchange(empty, make(user=asking))
    assert [event.reason for event in events(asking)] == ["no application 512 at this end"]


def test_what_goes_from_this_end_to_this_end_takes_no_radio():
    own, asking = application(), user()
    node = make(applications=[own], user=asking)
    asking.ping("oven", now_ns=0)
    assert sent(node) == []
    told = events(asking)
    assert told[0] == Alive("oven", 0) and isinstance(told[-1], CommandResult)
    local = [parse_packet(octets) for octets in iter(node.next_local, None)]
    expected = [(17, 1), (17, 2), (1, 1), (1, 3), (1, 7)]
    assert [(one.service, one.subtype) for one in local] == expected
    assert (node.sent, node.next_local()) == (0, None)
    # Of packets that wait, the newest 64 stay.
    for count in range(70):
        own.handle_telecommand(command(count=count, flags=0), 0)
        sent(node)
    assert len(list(iter(node.next_local, None))) == 64


def test_reports_for_everybody_go_both_ways_and_those_for_others_away():
    own, asking = application(), user()
    node = make(applications=[own], user=asking)
    own.handle_event("cooled", 0)
    (packet,) = packets(node)
    assert isinstance(asking.next_event(), EventReport) and node.next_local() is None
    assert packet.destination == 0
    node.handle_packet(pack_packet(command(source=8)), 0)
    assert [one.destination for one in packets(node)] == [8] * 4
    assert asking.next_event() is None


def test_a_packet_waits_for_the_bucket_and_says_how_long():
    one = make(k2aci=talk(), rate_bps=800)
    for _ in range(3):
        one.k2aci.endpoint.send(replace(TALK, text="x" * 200), 0)
    first, second = sent(one)
    assert (one.sent, one.delayed, one.max_age_ns) == (2, 1, 0)
    assert one.sent_octets == len(first) + len(second)
    due_ns = one.poll_timeout(0)
    # 512 octets at once, and 100 a second afterwards.
    assert due_ns == pytest.approx((3 * len(first) - 512) * S // 100, abs=MS)
    assert one.poll_transmit(due_ns - MS) is None
    assert one.poll_transmit(due_ns) is not None
    assert (one.sent, one.delayed, one.max_age_ns) == (3, 1, due_ns)
    with pytest.raises(ConfigError, match="a rate above 0"):
        make(rate_bps=0)
    # One without these parts has nothing to repeat.
    make(rate_bps=1).handle_contact(0)


def test_a_node_is_due_with_the_first_of_its_parts_and_repeats_with_a_new_contact():
    own, asking = application(), user(timeout_ns=300 * MS)
    node = make(user=asking, k2aci=talk(timeout_ns=200 * MS))
    assert node.poll_timeout(0) is None
    asking.ping("oven", now_ns=0)
    sent(node)
    assert node.poll_timeout(0) == 300 * MS
    node.k2aci.endpoint.send(TALK, 0)
    sent(node)
    assert node.poll_timeout(0) == 200 * MS
    node.handle_contact(50 * MS)
    assert node.poll_timeout(50 * MS) == 50 * MS
    assert len(sent(node, 50 * MS)) == 2
    both = make(applications=[own], user=asking)
    own.handle_values({"temperature": 1.0, "door": "open"}, 0)
    assert both.poll_timeout(0) == 0
