"""A user's component for tests, and the two ends of TM/TC that it is in."""

from pipelines.mission.component_service import ComponentService
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import SendCommand
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.routes import with_routes
from telepresence.tmtc.telemetry_source import (
    Component,
    FunctionCall,
    TelemetryEvent,
    TelemetryFunction,
    TelemetryParameter,
    TelemetryReading,
    TelemetrySource,
    application_of,
    with_components,
)

MS = 1_000_000
S = 1_000 * MS


class Battery(TelemetrySource):
    """Says what a test tells it to."""

    name = "battery"
    parameters = (
        TelemetryParameter(
            name="voltage", unit="V", low=11.1, high=14.4, below="low", above="high", period_s=1.0
        ),
        TelemetryParameter(name="target", unit="V", low=11.1, high=14.4, period_s=None),
        TelemetryParameter(name="limit", type="u8", unit="A", high=40, period_s=1.0, writable=True),
        TelemetryParameter(name="cell", type="choice", choices=("a", "b"), period_s=None),
    )
    events = (
        TelemetryEvent(name="low", severity="medium", arguments=("voltage",)),
        TelemetryEvent(name="high", severity="high", arguments=("voltage",)),
        TelemetryEvent(name="opened"),
    )
    functions = (
        TelemetryFunction(name="recharge", arguments=("target",)),
        TelemetryFunction(name="use", arguments=("cell",)),
    )

    def __init__(self):
        self.values = {"voltage": 12.0}
        self.raised = []
        self.calls = []
        self.answer = None
        self.settings = []
        self.heard = []
        self.data = []
        self.follows = lambda event: ()

    def read(self):
        raised, self.raised = self.raised, []
        return TelemetryReading(self.values, raised)

    def set(self, name, value):
        self.settings.append((name, value))

    def call(self, function, arguments):
        self.calls.append((function, arguments))
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def handle_data(self, application, values):
        self.data.append((application, dict(values)))

    def handle_event(self, event):
        self.heard.append((event.application, event.event, dict(event.values)))
        return self.follows(event)


def recharges(event):
    """After each of its events the battery is recharged."""
    if event.application == "battery":
        yield FunctionCall("battery", "recharge", (12.5,))


class Mission:
    """Both ends, with a battery on the ground. Time goes on with `run`.

    taken: whether the end takes what the component asks for. told: news of both ends.
    """

    def __init__(self, source=None, settings=None, routes=()):
        self.battery = source or Battery()
        self.table = application_of(self.battery, 0x140)
        known = built_in_dictionary()
        known = with_components(known, [Component("tests:Battery", self.table)])
        self.dictionary, self.routes = with_routes(known, routes, ["battery"]), routes
        boot_id = {"now_ns": 0, "first_count": 1, "boot_id": 1, "routes": routes}
        self.ends = {one: TmtcEnd(one, self.dictionary, **boot_id) for one in Segment}
        self.now_ns, self.taken, self.number = 0, True, 0
        self.told = []
        self.packets = []
        self.restart(settings or {})

    def restart(self, settings):
        """Its process begins a new start."""
        boot_id = {"now_ns": self.now_ns, "client": f"battery {self.now_ns}"}
        boot_id |= {"settings": settings, "routes": self.routes}
        self.service = ComponentService(self.battery, self.table, **boot_id)

    def ask(self, verb, name="", *arguments, application="battery", **more):
        """A telecommand from space; return its end once it is there."""
        self.number += 1
        request = SendCommand("test", self.number, application, verb, name, arguments, **more)
        self.ends[Segment.SPACE].handle_request(request, self.now_ns)
        self.run(2)
        mine = (one for one in self.told if getattr(one, "client", "") == "test")
        found = [one for one in mine if one.id == self.number and one.done]
        return found[-1] if found else None

    def ends_event(self, application, event):
        """An application of the ground, other than the battery, reports an event."""
        end = self.ends[Segment.GROUND]
        end.handle_values(application, {"error": "speed"}, self.now_ns)
        end.handle_event(application, event, self.now_ns)
        self.step()

    def run(self, seconds):
        until_ns = self.now_ns + round(seconds * S)
        while self.now_ns < until_ns:
            self.now_ns += 50 * MS
            self.step()

    def step(self):
        now_ns = self.now_ns
        self.service.handle_time(now_ns)
        while (request := self.service.poll_transmit(now_ns)) is not None and self.taken:
            self.ends[Segment.GROUND].handle_request(request, now_ns)
            self.service.handle_sent(request, now_ns)
        for segment, end in self.ends.items():
            for octets in iter(lambda end=end: end.poll_transmit(now_ns), None):
                self.packets.append(octets)
                self.ends[segment.peer].handle_packet(octets, now_ns)
            for news in iter(end.next_event, None):
                self.told.append(news)
                if segment is Segment.GROUND:
                    self.service.handle_news(news, now_ns)

    def metrics(self):
        """What its process counts."""
        told = []
        self.service.publish(
            type("Probe", (), {"publish": lambda _self, record: told.append(record)})()
        )
        return told[0]
