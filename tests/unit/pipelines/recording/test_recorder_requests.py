"""What the recorder answers to terminals."""

from kontur_av.clock import NS_PER_S
from pipelines.recording.recorder_requests import HOLD_NS, Ask, RecorderRequests, Start, Stop
from pipelines.session import terminal_lines

WISH = terminal_lines.RecordingOptions(file="/tmp/a.mcap")
HELD = terminal_lines.RecordingOptions(file="/tmp/a.mcap", held=True)


class Talk:
    """A desk and its terminals, without sockets."""

    def __init__(self, options=None):
        self.service = RecorderRequests(options, 0)
        self.answers = {}
        self.closed = set()
        self.did = []
        self.error = ""

    def say(self, terminal, request, now_ns=0):
        if terminal not in self.service.asking:
            self.service.handle_terminal(terminal)
        octets = request if isinstance(request, bytes) else terminal_lines.pack_line(request)
        self.service.handle_octets(terminal, octets, now_ns)
        self.drain()
        return self.answers.get(terminal)

    def drain(self):
        while (event := self.service.next_event()) is not None:
            self.did.append(type(event))
            match event:
                case terminal_lines.Reply():
                    if event.octets:
                        self.answers[event.terminal] = terminal_lines.parse_line(
                            event.octets, terminal_lines.RecordAnswer
                        )
                    if event.last:
                        self.closed.add(event.terminal)
                case Start():
                    self.service.handle_started(event, self.error)
                case Stop():
                    self.service.handle_stopped(
                        event, terminal_lines.RecordAnswer(ok=True, messages=7)
                    )
                case Ask():
                    self.service.handle_state(
                        event, terminal_lines.RecordAnswer(ok=True, messages=3)
                    )


def start(options, **more):
    return terminal_lines.RecordRequest(record="start", options=options, **more)


def test_a_recording_is_started_asked_about_and_stopped_and_other_requests_are_refused():
    talk = Talk()
    assert talk.say(1, start(WISH)).ok
    assert talk.service.options == WISH
    assert talk.say(2, terminal_lines.RecordRequest(record="state")).messages == 3
    assert talk.say(2, terminal_lines.RecordRequest(record="stop")).messages == 7
    assert talk.service.options is None
    assert talk.say(2, terminal_lines.RecordRequest(record="stop")).mistake
    answer = Talk(WISH).say(1, start(terminal_lines.RecordingOptions(file="/tmp/b.mcap")))
    assert not answer.ok and answer.mistake and "/tmp/a.mcap" in answer.error
    talk = Talk()
    talk.error = "no such directory"
    assert talk.say(1, start(WISH)).error == "no such directory"
    assert talk.service.options is None
    talk = Talk()
    for garbage in (b"{}\n", b"[[[[\n", b'{"record": "jump"}\n', b'{"record": "start"}\n'):
        assert talk.say(1, garbage).mistake
    talk.say(1, b"x" * (terminal_lines.MAX_LINE_OCTETS + 1))
    assert 1 in talk.closed
    assert talk.service.options is None


def test_a_held_recording_ends_some_time_after_its_terminal_which_may_come_back():
    talk = Talk()
    talk.say(1, start(HELD))
    talk.service.handle_time(100 * NS_PER_S)
    talk.say(1, b"", 100 * NS_PER_S)
    assert 1 in talk.closed
    talk.service.handle_time(100 * NS_PER_S + HOLD_NS - 1)
    talk.drain()
    assert talk.service.options == HELD
    talk.service.handle_time(100 * NS_PER_S + HOLD_NS)
    talk.drain()
    assert talk.service.options is None
    talk = Talk(HELD)
    assert talk.say(5, start(HELD), NS_PER_S).ok, "after the recorder was killed"
    needs_none = Talk(WISH)
    for one in (talk, needs_none):
        one.service.handle_time(1000 * NS_PER_S)
        one.drain()
    assert Start not in talk.did and talk.service.options == HELD
    assert needs_none.service.options == WISH
