"""How two ends find each other, what they send, and what losses, restarts and intruders change."""

from dataclasses import replace
from itertools import pairwise
from random import Random

import pytest
from link_supervision_pair import CONNECTED, GROUND, MS, SPACE, UP, Pair, S, connected

from kontur_av.clock import NS_PER_S
from telepresence.link.profile import DOWNLINK
from telepresence.link.supervision.message import (
    LinkState,
    MessageKind,
    SupervisionTiming,
    pack_message,
    parse_message,
)
from telepresence.link.supervision.record import (
    ApplicationReset,
    PeerDeaf,
    PeerDoubted,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
    StateChanged,
)
from telepresence.link.supervision.supervisor import ApplicationWatch, Encounter, Supervisor


def metrics(pair, end):
    return end.supervisor.report(pair.slot * MS)


def assert_counted(pair, end):
    """The counts of an end are those of its events, since it was started."""
    report = metrics(pair, end)
    counts = dict(report.counts)
    causes = [event.why for event in end.of(StateChanged)]
    assert counts.pop("messages_sent") == len(end.sent)
    assert counts.pop("signals_acquired") == len(end.of(SignalAcquired))
    assert counts.pop("signals_lost") == len(end.of(SignalLost))
    assert counts.pop("peer_restarts") == sum(event.restarted for event in end.of(PeerMet))
    assert counts.pop("peer_deaf") == len(end.of(PeerDeaf))
    for why in ("idle", "broken"):
        resets = [event for event in end.of(ApplicationReset) if event.why == why]
        assert counts.pop(f"resets_{why}") == len(resets)
    assert counts.pop("timeouts_answer") == sum(
        why.startswith("time-out: the slave") for why in causes
    )
    assert counts.pop("timeouts_silence") == sum(
        why.startswith("time-out: frames") for why in causes
    )
    assert set(counts) == {"messages_received", "messages_malformed", "messages_mismatched"}
    assert len(report.contacts) == len(end.of(SignalAcquired))
    assert sum(report.in_state_ns.values()) == pair.slot * MS - report.begun_ns


SIDES = pytest.mark.parametrize("who", ["ground", "space"])


def ends(pair, who):
    """The end of this name, and the other one."""
    return pair.ends if who == "ground" else pair.ends[::-1]


def counts_of(pair, kind):
    return [len(end.of(kind)) for end in pair.ends]


@pytest.mark.parametrize(
    ("delay_slots", "late"), [(0, 0), (5, 0), (15, 0), (400, 0), (12, 30), (12, -30), (12, 10_000)]
)
def test_connects_in_two_round_trips_and_a_few_messages(delay_slots, late):
    """late: slots by which space starts after the ground."""
    pair = Pair(delay_slots=delay_slots)
    first, second = ends(pair, "ground" if late >= 0 else "space")
    first.start(7, 0)
    pair.run(abs(late))
    assert not late or first.supervisor.state is LinkState.SEARCH
    second.start(8, pair.slot)
    pair.run(5 * delay_slots + 100)
    assert pair.states == CONNECTED
    for end in pair.ends:
        states = pair.history(end)
        assert states[:3] == ["check", "search", "configure"]
        # Data that arrived before the two had agreed approves the link at once.
        assert states[3:] in (["connected"], ["approve", "connected"])
    for kind in (SignalAcquired, PeerMet, PeerHears):
        assert counts_of(pair, kind) == [1, 1]
    for kind in (SignalLost, PeerDeaf, ApplicationReset):
        assert counts_of(pair, kind) == [0, 0]


def test_another_life_in_the_peers_stream_must_prove_itself():
    """A single message may be a bit error that the FECF did not detect; the second ends it."""
    pair = connected()
    pair.run(1 * S)
    supervisor, other = pair.ground.supervisor, pair.space.supervisor
    unknown = Supervisor(
        master=False, configuration=other.configuration, boot_id=0x5555, now_ns=0, secret=1
    )
    unknown.handle_local_check(None, 0)
    now_ns = pair.slot * MS
    supervisor.handle_message(unknown.poll_transmit(0), now_ns)
    pair.drain(pair.ground)
    assert pair.ground.followed == 0x2222
    supervisor.handle_message(unknown.poll_transmit(20 * MS), now_ns)
    pair.drain(pair.ground)
    assert (pair.ground.followed, supervisor.signal) == (None, False)
    assert len(pair.ground.of(PeerDoubted)) == len(pair.ground.of(SignalLost)) == 1
    # The peer answers, and nothing of its life has changed.
    pair.run(60)
    assert pair.states == CONNECTED
    assert len(pair.ground.of(PeerMet)) == 1


def test_frames_without_messages_time_out():
    pair = connected()
    for slot in range(pair.slot, pair.slot + 10 * S):
        pair.ground.supervisor.handle_frame(slot * MS)
        pair.ground.supervisor.poll_transmit(slot * MS)
        pair.drain(pair.ground)
    assert pair.ground.supervisor.state is LinkState.SEARCH
    assert pair.ground.of(PeerDeaf)
    assert pair.ground.supervisor.delivering


@pytest.mark.parametrize(
    ("silent_ms", "frames", "lasts_ms", "hears", "followed"),
    [
        (None, 8, 20, False, True),
        (None, 7, 20, False, False),
        (None, 8, 19, False, False),
        (None, 5000, 5000, True, False),
        (2000, 8, 1000, False, True),
        (1999, 8, 1000, False, False),
        (2000, 8, 999, False, False),
        (2000, 7, 1000, False, False),
        (60_000, 5000, 5000, True, False),
    ],
)
def test_when_a_stranger_that_hears_nobody_is_followed(
    silent_ms, frames, lasts_ms, hears, followed
):
    """silent_ms: how long the peer has been silent; None: no peer was ever met."""
    pair = Pair()
    pair.start()
    if silent_ms is None:
        now_ns = 0
    else:
        pair.run(200)
        now_ns = pair.ground.supervisor._frame_ns + silent_ms * MS
        pair.ground.supervisor.poll_transmit(now_ns)
    unknown = Supervisor(master=False, configuration=SPACE, boot_id=0x5555, now_ns=now_ns, secret=1)
    unknown.handle_local_check(None, now_ns)
    if hears:
        unknown.handle_frame(now_ns)
    message = unknown.poll_transmit(now_ns)
    supervisor = pair.ground.supervisor
    found = supervisor.handle_unknown_sender(message, now_ns, frames=frames, lasts_ns=lasts_ms * MS)
    assert found is (Encounter.RESTART if followed else Encounter.IGNORE)


def test_a_stranger_beside_a_live_peer_is_asked_ten_times_a_second():
    """Also one without any message: it may be the peer, whose delay has fallen."""
    pair = connected()
    pair.run(3 * S)
    supervisor, asked = pair.ground.supervisor, []
    for slot in range(2000):
        lasts_ns = (slot + 1) * MS if slot < 1000 else 4 * MS
        supervisor.handle_unknown_sender(None, pair.slot * MS, frames=slot + 1, lasts_ns=lasts_ns)
        sent = len(pair.ground.sent)
        pair.step()
        for at, message in pair.ground.sent[sent:]:
            told = parse_message(message)
            if told.kind is MessageKind.HELLO:
                asked.append(at)
                assert told.number
    assert len(asked) in (10, 11)
    assert min(b - a for a, b in pairwise(asked)) == 100
    # The peer's answers change nothing.
    assert pair.states == CONNECTED
    assert not pair.ground.of(PeerDoubted) + pair.ground.of(SignalLost)
    # Afterwards nobody asks and answers any more.
    sent = [len(end.sent) for end in pair.ends]
    pair.run(10 * S)
    assert max(len(end.sent) - n for end, n in zip(pair.ends, sent, strict=True)) <= 21


@pytest.mark.parametrize("blackout", [100, 1_000, 6_000])
@pytest.mark.parametrize("delay_slots", [0, 12, 400])
def test_blackout_both_ways(blackout, delay_slots):
    pair = connected(delay_slots=delay_slots)
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(blackout)
    pair.blocked = dict.fromkeys(pair.blocked, False)
    back_ns = (pair.slot + delay_slots) * MS
    for end in pair.ends:
        end.delivered.clear()
    pair.run(3 * delay_slots + 100)
    assert pair.states == CONNECTED or delay_slots > 12
    for end in pair.ends:
        # A loss is noticed at the receiver, up to a delay after it began.
        lost, again = metrics(pair, end).contacts
        assert again.acquired_ns - back_ns <= MS
        assert again.acquired_ns - lost.lost_ns == (blackout + 1) * MS
        assert metrics(pair, end).longest_gap_ns >= blackout * MS
        if blackout > 50 + delay_slots:
            # The very first frame is delivered, because this start was checked before.
            assert end.delivered[0][0] == again.acquired_ns
    pair.run(1 * S)
    assert pair.states == CONNECTED and counts_of(pair, PeerMet) == [1, 1]


@pytest.mark.parametrize("gap", [1, 20, 47, 55])
def test_a_loss_is_noticed_within_50_ms_of_the_last_frame_and_no_shorter_gap(gap):
    for slot in range(6):
        pair = connected(delay_slots=slot)
        pair.run(slot)
        pair.blocked["ground"] = True
        pair.run(gap)
        pair.blocked["ground"] = False
        pair.run(100)
        assert pair.states == CONNECTED
        assert counts_of(pair, SignalLost) == [0, gap > 50]
        for lost in pair.space.of(SignalLost):
            assert 0 < lost.now_ns - lost.last_ns <= 50 * MS


@pytest.mark.parametrize("seed", range(6))
def test_it_ends_connected_after_any_disturbances(seed):
    """Blackouts, lost and corrupted messages, restarts, faults; then no more disturbances."""
    random = Random(seed)
    pair = Pair(delay_slots=random.choice((0, 1, 7, 40, 130, 400)))
    pair.message_loss, pair.garble = random.choice((0.0, 0.3)), random.choice((0.0, 0.1))
    pair.random = Random(seed + 1000)
    pair.start()
    for step in range(30):
        end = random.choice(pair.ends)
        match random.randrange(6):
            case 0 | 1:
                pair.blocked[end.name] = not pair.blocked[end.name]
            case 2:
                pair.blocked = dict.fromkeys(pair.blocked, random.random() < 0.5)
            case 3:
                end.start(step + 1, pair.slot)
            case 4:
                fault = random.choice((None, "a fault"))
                end.supervisor.handle_local_check(fault, pair.slot * MS)
            case 5:
                end.sends = not end.sends
        for _ in range(random.choice((1, 30, 60, 300, 2000))):
            pair.step()
            for one in pair.ends:
                if one.supervisor.state is LinkState.CONNECTED:
                    assert one.supervisor.signal
                    assert one.supervisor.peer_hears
                    assert one.supervisor.delivering
    pair.blocked = dict.fromkeys(pair.blocked, False)
    for end in pair.ends:
        end.supervisor.handle_local_check(None, pair.slot * MS)
        end.sends = True
    pair.run(4 * pair.delay_slots + 1500)
    assert pair.states == CONNECTED
    before = counts_of(pair, StateChanged), counts_of(pair, ApplicationReset)
    pair.run(10 * S)
    assert before == (counts_of(pair, StateChanged), counts_of(pair, ApplicationReset))
    for end in pair.ends:
        pair.drain(end)
        assert_counted(pair, end)


def talk(pair, *names):
    """Only these ends send data."""
    for end in pair.ends:
        end.sends = end.name in names


@SIDES
def test_an_idle_link_is_reset_once_and_one_way_data_is_no_fault(who):
    pair = connected()
    talk(pair)
    pair.run(20 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    resets = pair.ground.of(ApplicationReset) + pair.space.of(ApplicationReset)
    assert {reset.why for reset in resets} == {"idle"}
    assert max(counts_of(pair, ApplicationReset)) == 1
    talk(pair, who)
    pair.run(20 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    assert sum(counts_of(pair, ApplicationReset)) == len(resets)
    # A packet in the other direction every five seconds, as with RTCP, keeps it connected.
    other = ends(pair, who)[1]
    other.sends, other.period = True, 5 * S
    pair.run(6 * S)
    assert pair.states == CONNECTED
    changes = counts_of(pair, StateChanged)
    pair.run(20 * S)
    assert changes == counts_of(pair, StateChanged)
    for end in pair.ends:
        assert_counted(pair, end)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"space": replace(SPACE, version=5)}, "version"),
        ({"space": replace(SPACE, receive_flows=UP[:2])}, "frames or flows differ"),
        (
            {"space": replace(SPACE, transmit=replace(DOWNLINK, frame_octets=400))},
            "downlink has",
        ),
        ({"masters": (True, True)}, "both ends are master"),
        ({"masters": (False, False)}, "both ends are slave"),
    ],
)
@pytest.mark.parametrize("late", [0, 100])
def test_a_mismatch_is_refused_and_named_until_it_is_gone(options, why, late):
    pair = Pair(**options)
    pair.never_connected = True
    pair.ground.start(1, 0)
    pair.run(late)
    pair.space.start(2, late)
    pair.run(20 * S)
    for end in pair.ends:
        assert end.supervisor.state is LinkState.REFUSED
        assert why in end.supervisor.why
        assert not end.delivered and not end.supervisor.delivering
        assert len(end.sent) < 20 * 20 + 100
        assert "refused" in pair.history(end)
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(200)
    assert pair.states == ("SEARCH", "SEARCH")
    # Restarted with the right configuration, it is accepted at once.
    pair.blocked = dict.fromkeys(pair.blocked, False)
    pair.never_connected = False
    pair.space.configuration = SPACE
    pair.ground.master, pair.space.master = True, False
    pair.start()
    pair.run(100)
    assert pair.states == CONNECTED


def test_the_local_check_comes_first():
    pair = connected()
    pair.space.supervisor.handle_local_check("no robot", pair.slot * MS)
    pair.run(50)
    assert pair.states == ("CONFIGURE", "CHECK")
    assert "local check" in pair.ground.supervisor.why
    count = len(pair.space.delivered)
    pair.never_connected = True
    pair.run(20 * S)
    assert pair.states == ("CONFIGURE", "CHECK")
    assert len(pair.space.delivered) == count
    assert len(pair.ground.of(StateChanged)) < 10
    pair.never_connected = False
    pair.space.supervisor.handle_local_check(None, pair.slot * MS)
    pair.run(50)
    assert pair.states == CONNECTED


class Near:
    """The ground's end, which follows a stream that could not prove itself: it hears nobody.

    The far end is a supervisor, too. Only its HELLOs arrive, with the numbers of the test.
    """

    def __init__(self):
        options = {"now_ns": 0, "secret": 5}
        self.supervisor = Supervisor(master=True, configuration=GROUND, boot_id=1, **options)
        far = Supervisor(master=False, configuration=SPACE, boot_id=2, **options)
        for end in (self.supervisor, far):
            end.handle_local_check(None, 0)
        self.template = parse_message(far.poll_transmit(0))
        assert self.template.kind is MessageKind.HELLO
        self.now_ns = frames = 0
        found = Encounter.IGNORE
        while found is Encounter.IGNORE and frames < 100:
            self.run(1)
            frames += 1
            found = self.supervisor.handle_unknown_sender(
                self.hello(), self.now_ns, frames=frames, lasts_ns=self.now_ns
            )
        assert 1 < frames < 100
        self.receive()

    def hello(self, **fields):
        return pack_message(self.template._replace(**{"number": 0, "echo": 0} | fields))

    def receive(self, **fields):
        self.supervisor.handle_message(self.hello(**fields), self.now_ns)

    def run(self, slots):
        """Return the HELLOs that go out; frames of the far end keep the signal."""
        sent = []
        for _ in range(slots):
            self.now_ns += MS
            if self.supervisor.signal:
                self.supervisor.handle_frame(self.now_ns)
            if (message := self.supervisor.poll_transmit(self.now_ns)) is not None:
                sent.append(parse_message(message))
        return [message for message in sent if message.kind is MessageKind.HELLO]

    def asked(self):
        """Ask it something; return the HELLO that answers."""
        self.receive(number=77)
        return self.run(30)[0]

    def hears(self):
        return any(isinstance(one, PeerHears) for one in iter(self.supervisor.next_event, None))


def test_a_question_is_answered_with_its_number():
    near = Near()
    for number in (78, 79):
        near.receive(number=number)
        assert near.run(30)[0].echo == number


@pytest.mark.parametrize(("error", "proven"), [(0, True), (1, False)])
def test_an_echo_of_the_own_number_proves_the_peer_and_that_it_hears(error, proven):
    near = Near()
    number = near.asked().number
    assert number, "it asks, because the peer is not proven"
    near.hears()
    near.receive(echo=number ^ error, signal=True)
    assert near.hears() == proven
    assert (near.asked().number == 0) == proven


def test_questions_without_end_are_answered_a_hundred_times_a_second():
    near, sent = Near(), []
    for number in range(1, 201):
        near.receive(number=number)
        sent += near.run(1)
    assert len(sent) in (20, 21)


def test_messages_are_counted_at_both_ends_and_garbled_ones_as_such():
    pair = connected().run(5 * S)
    for end, other in (pair.ends, pair.ends[::-1]):
        assert_counted(pair, end)
        on_the_way = sum(message is not None for _, _, message, _ in pair.paths[other.name])
        counts = metrics(pair, end).counts
        assert counts["messages_received"] == len(other.sent) - on_the_way
        assert counts["messages_malformed"] == counts["messages_mismatched"] == 0
        for _ in range(3):
            end.supervisor.handle_message(bytes(12), pair.slot * MS)
        end.supervisor.handle_unknown_sender(bytes(12), pair.slot * MS, frames=1, lasts_ns=0)
        assert metrics(pair, end).counts == {**counts, "messages_malformed": 4}


TIMING = SupervisionTiming()


def test_an_application_link_is_reset_when_idle_and_when_broken():
    """2 s without data; a broken one after a round trip more, then twice as long each time."""
    watch = ApplicationWatch(TIMING, 0)
    assert not watch.fresh(0) and not watch.sending(0)
    watch.arrived_ns = watch.sent_ns = 10 * NS_PER_S
    watch.handle_first()
    assert watch.arrived and watch.fresh(12 * NS_PER_S - 1) and not watch.fresh(12 * NS_PER_S)
    assert watch.sending(12 * NS_PER_S - 1) and not watch.sending(12 * NS_PER_S)

    def due(now_ns, *, peer_fresh=False, approved=True):
        return watch.reset_due(peer_fresh=peer_fresh, approved=approved, now_ns=now_ns)

    assert due(12 * NS_PER_S - 1) is None
    assert (
        due(12 * NS_PER_S, peer_fresh=True) is None and due(12 * NS_PER_S, approved=False) is None
    )
    watch.sent_ns = 11 * NS_PER_S
    assert due(12 * NS_PER_S) is None and watch.arrived
    assert due(13 * NS_PER_S) == "idle" and not watch.arrived
    # The peer sends, and nothing comes.
    watch.handle_first()
    watch.handle_peer(was_reset=False, sends=True, now_ns=20 * NS_PER_S)
    watch.handle_peer(was_reset=False, sends=True, now_ns=21 * NS_PER_S)
    found = []
    for ms in range(20_000, 250_000, 100):
        if due(ms * MS, approved=False) == "broken":
            found.append(ms)
            assert not watch.arrived
    steps = [b - a for a, b in zip([20_000, *found], found, strict=False)]
    assert steps == [3_100, 5_100, 9_100, 17_100, 33_100, 65_100, 65_100]
    # Data at last: the waits are short again.
    watch.handle_first()
    watch.handle_contact(300 * NS_PER_S)
    assert not watch.arrived and due(303 * NS_PER_S, approved=False) is None
    watch.handle_peer(was_reset=False, sends=True, now_ns=301 * NS_PER_S)
    assert due(304 * NS_PER_S, approved=False) is None
    assert due(304 * NS_PER_S + 1, approved=False) == "broken"
    watch.handle_peer(was_reset=False, sends=False, now_ns=400 * NS_PER_S)
    assert due(500 * NS_PER_S, approved=False) is None
