"""One end of the TM/TC flow: who gets a packet, whose turn it is, and what stays at this end."""

import pytest
from pus_ends import MS, S, oven

from kontur_av.errors import ConfigError
from telepresence.tmtc.k2aci import Arrived, Chat, ChatRole, Delivered, K2aciEndpoint
from telepresence.tmtc.pus.application import PusApplication
from telepresence.tmtc.pus.node import K2aciLink, PusNode
from telepresence.tmtc.pus.packets import (
    Telecommand,
    Telemetry,
    ns_from_cuc,
    pack_packet,
    parse_packet,
)
from telepresence.tmtc.pus.user import Alive, CommandResult, EventReport, PusUser

TALK = Chat(sender=ChatRole.OPERATOR, text="hello")


def talking(**settings):
    """Two nodes with K2ACI between the applications 0x141 and 0x142."""
    ends = K2aciEndpoint(life=1), K2aciEndpoint(life=2)
    return [
        PusNode(
            k2aci=K2aciLink(end, apid=apid, peer=0x283 - apid),
            **{"rate_bps": 1_000_000, "epoch_ns": 9 * S} | settings,
        )
        for end, apid in zip(ends, (0x141, 0x142), strict=True)
    ]


def sent(node, now_ns=0):
    return list(iter(lambda: node.poll_transmit(now_ns), None))


def exchange(node, other, now_ns=0):
    packets = sent(node, now_ns)
    for octets in packets:
        other.handle_packet(octets, now_ns)
    return [parse_packet(octets) for octets in packets]


def test_k2aci_goes_from_one_application_to_its_peer():
    one, other = talking()
    for _ in range(2):
        one.k2aci.endpoint.send(TALK, 0)
    told = exchange(one, other, S)
    assert [
        (p.apid, p.destination, p.service, p.subtype, p.count, p.counter, ns_from_cuc(p.cuc) // S)
        for p in told
    ] == [(0x141, 0x142, 129, 1, count, count, 10) for count in range(2)]
    assert other.k2aci.endpoint.next_event() == Arrived(1, 0, TALK)
    answers = exchange(other, one, S)
    assert {(p.apid, p.destination) for p in answers} == {(0x142, 0x141)}
    assert one.k2aci.endpoint.next_event() == Delivered(0, TALK, S)
    assert (one.sent, one.received, one.garbage) == (2, 2, 0)
    assert one.sent_octets == sum(21 + len(p.data) for p in told)
    with pytest.raises(ConfigError, match="two applications"):
        K2aciLink(one.k2aci.endpoint, apid=5, peer=5)


def test_k2aci_of_others_is_ignored_and_garbage_counted():
    one, other = talking()
    one.k2aci.endpoint.send(TALK, 0)
    (packet,) = sent(one)
    right = parse_packet(packet)
    for field, value in (("apid", 9), ("destination", 9), ("service", 130), ("subtype", 2)):
        fields = {name: getattr(right, name) for name in right.__dataclass_fields__}
        other.handle_packet(pack_packet(Telemetry(**fields | {field: value})), 0)
    other.handle_packet(packet[:-1], 0)
    assert (other.received, other.garbage, other.k2aci.endpoint.arrived) == (4, 1, 0)
    # A user takes no K2ACI for a report of an application.
    user = PusUser(oven(), source=7, first_count=0)
    node = PusNode(user=user, rate_bps=1000)
    node.handle_packet(packet, 0)
    assert (node.received, user.unexpected, user.garbage) == (1, 0, 0)
    assert node.poll_timeout(0) is None


def test_no_flood_of_k2aci_keeps_a_report_waiting_and_telecommands_go_first():
    application = PusApplication(oven().application("oven"), now_ns=0)
    user = PusUser(oven(), source=7, first_count=0, foreign=None)
    endpoint = K2aciEndpoint(life=1)
    node = PusNode(
        applications=[application],
        k2aci=K2aciLink(endpoint, apid=0x141, peer=0x142),
        rate_bps=1_000_000,
    )
    node.handle_packet(
        pack_packet(Telecommand(apid=9, count=0, service=17, subtype=1, source=5)), 0
    )
    for _ in range(4):
        endpoint.send(TALK, 0)
        application.handle_event("cooled", 0)
    services = [parse_packet(octets).service for octets in sent(node)]
    assert services == [1, *[129, 5] * 4]
    node = PusNode(user=user, k2aci=node.k2aci, rate_bps=1_000_000)
    endpoint.send(TALK, S)
    user.ping("oven", now_ns=S)
    assert [parse_packet(octets).service for octets in sent(node, S)][:2] == [17, 129]


def test_a_failure_of_routing_names_the_telecommand_and_goes_to_its_source():
    node = PusNode(rate_bps=1_000_000, epoch_ns=2 * S)
    for count in range(18):
        node.handle_packet(
            pack_packet(Telecommand(apid=9, count=count, service=17, subtype=1, source=5)), S
        )
    # As many as the bucket holds, and the others later.
    found = [parse_packet(one) for now_ns in (S, 2 * S) for one in sent(node, now_ns)]
    # The newest 16 are kept.
    assert [(one.count, one.counter) for one in found] == [(n, n) for n in range(2, 18)]
    first = found[0]
    assert (first.apid, first.service, first.subtype, first.destination) == (9, 1, 10, 5)
    assert first.data == bytes.fromhex("1809c002 01") + b"no application 9 at this end"
    assert ns_from_cuc(first.cuc) == 3 * S


def own():
    """A node with an application and its user at the same end."""
    application = PusApplication(oven().application("oven"), now_ns=0)
    user = PusUser(oven(), source=7, first_count=0)
    return PusNode(applications=[application], user=user, rate_bps=1_000_000), application, user


def test_what_goes_from_this_end_to_this_end_takes_no_radio():
    node, application, user = own()
    user.ping("oven", now_ns=0)
    assert sent(node) == []
    events = list(iter(user.next_event, None))
    assert events[0] == Alive("oven", 0) and isinstance(events[-1], CommandResult)
    local = [parse_packet(octets) for octets in iter(node.next_local, None)]
    assert [(one.service, one.subtype) for one in local] == [
        *((17, 1), (17, 2), (1, 1), (1, 3), (1, 7))
    ]
    assert (node.sent, node.next_local()) == (0, None)
    # Of packets that wait, the newest 64 stay.
    for count in range(70):
        request = Telecommand(apid=0x200, count=count, service=17, subtype=1, source=7, flags=0)
        application.handle_telecommand(request, 0)
        sent(node)
    assert len(list(iter(node.next_local, None))) == 64


def test_reports_for_everybody_go_both_ways_and_those_for_others_away():
    node, application, user = own()
    application.handle_event("cooled", 0)
    (packet,) = sent(node)
    event = user.next_event()
    assert isinstance(event, EventReport) and node.next_local() is None
    assert parse_packet(packet).destination == 0
    node.handle_packet(
        pack_packet(Telecommand(apid=0x200, count=3, service=17, subtype=1, source=8)), 0
    )
    assert [parse_packet(one).destination for one in sent(node)] == [8] * 4
    assert user.next_event() is None


def test_a_packet_waits_for_the_bucket_and_says_how_long():
    one, _ = talking(rate_bps=800)
    talk = Chat(sender=ChatRole.OPERATOR, text="x" * 200)
    for _ in range(3):
        one.k2aci.endpoint.send(talk, 0)
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
        PusNode(rate_bps=0)
    PusNode(rate_bps=1)


def test_a_node_is_due_with_the_first_of_its_parts_and_repeats_with_a_new_contact():
    application = PusApplication(oven().application("oven"), now_ns=0)
    user = PusUser(oven(), source=7, first_count=0, timeout_ns=300 * MS)
    endpoint = K2aciEndpoint(life=1, timeout_ns=200 * MS)
    node = PusNode(user=user, k2aci=K2aciLink(endpoint, apid=0x141, peer=0x142), rate_bps=1_000_000)
    assert node.poll_timeout(0) is None
    user.ping("oven", now_ns=0)
    sent(node)
    assert node.poll_timeout(0) == 300 * MS
    endpoint.send(TALK, 0)
    sent(node)
    assert node.poll_timeout(0) == 200 * MS
    node.handle_contact(50 * MS)
    assert node.poll_timeout(50 * MS) == 50 * MS
    assert len(sent(node, 50 * MS)) == 2
    both = PusNode(applications=[application], user=user, rate_bps=1000)
    application.handle_values({"temperature": 1.0, "door": "open"}, 0)
    assert both.poll_timeout(0) == 0
    # One without these parts has nothing to repeat.
    PusNode(rate_bps=1).handle_contact(0)
