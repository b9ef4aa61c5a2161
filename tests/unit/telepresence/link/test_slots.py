"""When an end of the link wakes up, and the order of work in a slot."""

import random
from itertools import pairwise

import pytest

from telepresence.link.flows import Level, packet_flow
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath
from telepresence.link.slots import METRICS_NS, MOST_DATAGRAMS, GatewaySlots

MS = 1_000_000
US = 1000


def make_slots(first_ns=0, delay_ns=0):
    gateway = Gateway(
        transmit=UPLINK,
        transmit_flows=[packet_flow("picture", Level.VIDEO)],
        receive=DOWNLINK,
        receive_flows=[packet_flow("command", Level.TMTC)],
        master=True,
        boot_id=1,
        now_ns=0,
        radio=RadioPath(delay_ns=delay_ns),
    )
    return gateway, GatewaySlots(gateway, first_ns=first_ns)


def test_it_wakes_for_the_radio_between_two_slots():
    gateway, slots = make_slots(delay_ns=300 * US)
    slots.handle_slot([], 0)
    assert slots.poll_timeout() == 300 * US
    assert gateway.poll_transmit(300 * US) is not None
    assert slots.poll_timeout() == MS


@pytest.mark.parametrize("late_ns", [0, 30 * US, MS + 30 * US])
def test_a_late_slots_frame_leaves_the_radio_with_another_slot(late_ns):
    """Its delay counts from the slot's instant, so that it costs no wake-up of its own."""
    gateway, slots = make_slots(delay_ns=2 * MS)
    assert slots.handle_slot([], late_ns) == late_ns
    assert slots.deadline_ns == slots.poll_timeout() == late_ns // MS * MS + MS
    assert gateway.poll_timeout() == late_ns // MS * MS + 2 * MS


def test_the_newest_sample_is_sent_and_the_others_are_counted():
    gateway, slots = make_slots()
    samples = [bytes([number] * UPLINK.insert_octets) for number in range(3)]
    slots.handle_slot([samples[0], None, samples[1], samples[2]], 0)
    assert samples[2] in gateway.poll_transmit(0)
    assert gateway.sender.haptic_superseded == 2


def test_a_slot_takes_a_limited_number_of_datagrams():
    gateway, slots = make_slots()
    waiting = [("picture", bytes(10))] * (MOST_DATAGRAMS + 5)

    def port():
        while waiting:
            yield waiting.pop()

    slots.handle_datagrams(port(), 0)
    assert len(waiting) == 5
    assert gateway.sender.waiting_octets(Level.VIDEO) == 10 * MOST_DATAGRAMS
    # Datagrams of unknown senders take time too, so they count for the limit.
    waiting += [("radio", None)] * 100
    slots.handle_datagrams(port(), MS)
    assert len(waiting) == 105 - MOST_DATAGRAMS
    assert gateway.sender.waiting_octets(Level.VIDEO) == 10 * MOST_DATAGRAMS


def test_early_slots_do_nothing_and_late_ones_are_skipped():
    gateway, slots = make_slots(first_ns=MS)
    assert slots.handle_slot([bytes(12)], MS - 1) == -1
    assert gateway.poll_transmit(MS) is None
    assert slots.handle_slot([], 3 * MS + 1) == 2 * MS + 1
    assert slots.schedule.slips == 2
    assert slots.deadline_ns == 4 * MS


def test_a_late_slot_delays_no_report():
    _, slots = make_slots()
    chance = random.Random(2)
    reports = []
    for slot in range(100):
        slots.handle_datagrams([("picture", bytes(200))], slot * MS)
        slots.handle_slot([], slot * MS + chance.randrange(100 * US))
        if slots.poll_backlog() is not None:
            reports.append(slot)
    assert reports == list(range(0, 100, 4))


@pytest.mark.parametrize("heard", [True, False])
def test_metrics_wait_for_a_frame_while_the_peer_is_heard(heard):
    _, slots = make_slots()
    done = []
    for slot in range(500):
        now_ns = slot * MS
        slots.handle_slot([], now_ns)
        if slots.poll_metrics(now_ns, heard=False):
            done.append(now_ns)
        if heard and slots.poll_metrics(now_ns + 400 * US, heard=True):
            done.append(now_ns + 400 * US)
    assert {at % MS for at in done} == ({400 * US} if heard else {0})
    assert all(b - a >= METRICS_NS for a, b in pairwise(done))
    assert len(done) == (5 if heard else 2)


def test_metrics_are_not_collected_shortly_before_a_slot():
    _, slots = make_slots()
    slots.handle_slot([], 0)
    assert not slots.poll_metrics(600 * US, heard=True)
    assert slots.poll_metrics(400 * US, heard=True)
