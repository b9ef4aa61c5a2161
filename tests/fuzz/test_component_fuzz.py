"""Whatever a user's component says and follows events with: nothing is raised, and the end of its
telemetry understands each request."""

from battery import Battery, Mission
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.mission.tmtc_messages import MAX_REQUEST_OCTETS, pack_request, unpack_request
from telepresence.tmtc.telemetry_source import FunctionCall, TelemetryReading

NAMES = st.sampled_from(["voltage", "target", "limit", "cell", "amps", "low", "opened", ""])
VALUES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=300)
CALLS = st.builds(
    FunctionCall,
    st.sampled_from(["battery", "robot", "nobody"]),
    st.sampled_from(["recharge", "use", "power_off", "none"]),
    st.lists(VALUES, max_size=3).map(tuple),
)


class Erratic(Battery):
    """Says whatever it is given, again and again."""

    def __init__(self, readings, follows, answer):
        super().__init__()
        self.readings, self.answer, self.follows = readings, answer, follows and (lambda _: follows)

    def read(self):
        self.readings.append(self.readings.pop(0))
        return self.readings[0]

    def handle_event(self, event):
        return self.follows(event) if self.follows else None


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.builds(TelemetryReading, st.dictionaries(NAMES, VALUES), st.lists(NAMES, max_size=12)),
        min_size=1,
        max_size=4,
    ),
    st.lists(CALLS | VALUES, max_size=12),
    VALUES,
)
def test_nothing_that_a_component_says_is_raised_or_not_understood(readings, follows, answer):
    mission = Mission(Erratic(readings, follows, answer))
    poll = mission.service.poll_transmit

    def checked(now_ns):
        request = poll(now_ns)
        if request is not None:
            octets = pack_request(request)
            assert len(octets) <= MAX_REQUEST_OCTETS and unpack_request(octets) is not None
        return request

    mission.service.poll_transmit = checked
    # `TmtcEnd.handle_request` raises for values and events that no table has.
    mission.run(2)
    assert mission.ask("ping").ok
    assert mission.ask("call", "recharge", 12.0) is not None
