"""A session on virtual time, without media, in whose telemetry a test takes part."""

from dataclasses import replace

from pipelines.mission.tmtc_messages import FunctionAsked, FunctionDone, SendCommand, SendK2aci
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.session import Simulation
from pipelines.virtual.workers import Workers

S = 1_000_000_000


class Session:
    """Its functions are carried out at once, if `answers`. joystick: as of `Simulation`.

    news: all news by segment, with the instants. packets: those of PUS that a segment's end took
    from the radio; carried: all that came on the flow. asked: functions, with their applications.
    """

    def __init__(self, setup="spacejustin", *, answers=True, media=False, joystick=None, **changes):
        setup = replace(BUILT_IN[setup], **changes)
        self.simulation = Simulation(setup, Workers(), seed=3, media=media, joystick=joystick)
        self.tmtc = self.simulation.tmtc
        self.news = {segment: [] for segment in Segment}
        self.asked = []
        self.packets = {segment: [] for segment in Segment}
        self.carried = {segment: [] for segment in Segment}
        for segment, end in self.tmtc.ends.items():
            end.handle_packet = self._noting(segment, end.handle_packet)
        self.now_ns = 0
        for segment, news in self.news.items():
            self.tmtc.subscribe(segment, lambda one, now, news=news: news.append((now, one)))
            if answers:
                self.tmtc.subscribe(segment, self.answer(segment))

    def _noting(self, segment, take):
        def note(data, now_ns):
            self.carried[segment].append(data)
            taken = take(data, now_ns)
            if taken:
                self.packets[segment].append(data)
            return taken

        return note

    def answer(self, segment):
        def take(news, now_ns):
            if isinstance(news, FunctionAsked):
                self.asked.append((news.application, news.function))
                done = FunctionDone(news.application, news.token)
                self.tmtc.handle_request(segment, done, now_ns)

        return take

    def run(self, seconds):
        self.now_ns += round(seconds * S)
        self.simulation.run(self.now_ns)

    def say(self, segment, number, text):
        fields = {"sender": "cosmonaut", "text": text}
        self.tmtc.handle_request(segment, SendK2aci("test", number, "Chat", fields), self.now_ns)

    def command(self, segment, number, application, verb, name="", **more):
        request = SendCommand("test", number, application, verb, name, **more)
        self.tmtc.handle_request(segment, request, self.now_ns)

    def of(self, segment, kind):
        return [one for _, one in self.news[segment] if isinstance(one, kind)]
