"""Any datagrams at a session by UDP: each is counted, none is raised, and no reading is made of it.

The faults that a network makes of a controller's own datagrams end in silence or in its place.
"""

from hypothesis import given
from hypothesis import strategies as st
from udp_controller import connected


def refused(report):
    return report.udp_foreign + report.udp_malformed + report.udp_late


near = st.builds(
    lambda kind, rest: bytes([1, kind, 2, 0]) + rest, st.integers(0, 5), st.binary(max_size=210)
)


@given(st.lists(st.binary(max_size=220) | near, max_size=20))
def test_strangers_change_nothing(datagrams):
    line = connected()
    before, reading = line.session.report(), line.session.reading
    for datagram in datagrams:
        line.session.handle_datagram(datagram)
    after = line.session.report()
    assert line.session.reading is reading and not line.session.silent
    assert refused(after) - refused(before) == len(datagrams)
    assert after.udp_readings == before.udp_readings


FAULTS = st.sampled_from(["lost", "late", "twice", "cut", "bit"])


@given(st.lists(st.tuples(FAULTS, st.integers(0, 600))))
def test_a_network_that_mixes_datagrams_leaves_only_newer_readings(faults):
    line = connected()
    session, late = line.session, []
    newest = 0
    for fault, where in faults:
        line.send()
        came, line.came = line.came, []
        for datagram in came:
            if fault == "late":
                late.append(datagram)
            elif fault == "twice":
                session.handle_datagram(datagram)
                session.handle_datagram(datagram)
            elif fault == "cut":
                session.handle_datagram(datagram[: where % len(datagram)])
            elif fault == "bit":
                at = where % len(datagram)
                session.handle_datagram(
                    datagram[:at] + bytes([datagram[at] ^ 1]) + datagram[at + 1 :]
                )
        if late and where % 3 == 0:
            session.handle_datagram(late.pop(where % len(late)))
        assert session.reading.number >= newest
        newest = session.reading.number
        assert session.reading.answers <= session.reading.number
    line.controller.restart()
    for _ in range(205):
        line.send()
        line.receive()
    assert not session.silent
