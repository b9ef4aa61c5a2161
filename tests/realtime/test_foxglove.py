"""A session's channels in Foxglove's client, beside the recording; its pictures in Chromium."""

import base64
import contextlib
import os
import signal
from collections import Counter
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count
from threading import Thread

import browser as browsers
import pytest
from foxglove_client import FoxgloveClient, address, needs_client
from mcap.reader import make_reader
from running_session import BOARD, RunningSession, assert_sound, eventually, tcp_port

from kontur_av.rtp.nal_formats import H264
from pipelines.recording.recorded_messages import RecordedPicture, unpack

ONCE = ("/figures", "/events", "/log")
#: Feeds a decoder with access units; how many pictures came, and each fault.
DECODE = """
const [units, done] = [arguments[0], arguments[1]];
let pictures = 0; const faults = [];
const decoder = new VideoDecoder({
  output: (frame) => { pictures += 1; frame.close(); },
  error: (fault) => faults.push(String(fault)),
});
decoder.configure({ codec: arguments[0][0].codec, optimizeForLatency: true });
for (const [index, { data, key }] of units.entries()) {
  if (decoder.state !== "configured") break;
  const octets = Uint8Array.from(atob(data), (one) => one.charCodeAt(0));
  decoder.decode(new EncodedVideoChunk(
    { type: key ? "key" : "delta", timestamp: index * 33000, data: octets }));
}
decoder.flush().catch((fault) => faults.push(String(fault)))
  .then(() => done([pictures, faults]));
"""


def recorded(path):
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(file).iter_messages()
        ]


def is_video(topic):
    return topic.startswith("/camera/") or ("_video/" in topic and not topic.endswith("/facts"))


def compare(received, written, counts):
    """Each message is in the recording, and each of the recording came, or was counted."""
    found = Counter(written)
    for topic in {topic for topic, *_ in received}:
        # Both code the pictures of a camera that no stream carries.
        if topic.startswith("/camera/"):
            continue
        own = [one for one in received if one[0] == topic]
        same = [one for one in own if found[one]]
        lost = counts[topic]["missed"] + counts[topic]["dropped"]
        # A key picture, its unit with parameter sets; all figures; a touch that lasts already.
        begun = 2 if is_video(topic) else topic.endswith("facts") or topic in ONCE
        assert len(own) - len(same) <= begun * (1 + lost), topic
        assert max(Counter(own).values()) == 1, topic
        if topic in ("/events", "/log"):
            continue  # touches of before are not told
        # By place, because several may have one instant, between two of which the client joined.
        own_written = [one for one in written if one[0] == topic]
        came = set(same)
        places = [place for place, one in enumerate(own_written) if one in came]
        due = places[-1] + 1 - places[0]
        # What came with other octets, as a key picture after a loss, is not lost itself.
        assert due - len(own) <= lost, (topic, due, len(own), len(same))


@contextlib.contextmanager
def page():
    """The address of an empty page on this machine, which Chromium trusts."""

    class Empty(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Empty) as server:
        Thread(target=partial(server.serve_forever, 0.05), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def assert_decodes(received):
    """Chromium's decoder, which starts with the first message, shows each of every channel."""
    with browsers.Browser() as browser, page() as url:
        shown = browser.open(url)
        for topic in {topic for topic, *_ in received if is_video(topic)}:
            units = [
                unpack(RecordedPicture, data).data for name, _, data in received if name == topic
            ]
            assert H264.parameter_sets(units[0]), topic
            codec = H264.parameter_sets(units[0]).split(b"\x67", 1)[1][:3].hex()
            chunks = [
                {
                    "data": base64.b64encode(unit).decode(),
                    "key": bool(H264.parameter_sets(unit)) and b"\x00\x00\x01\x65" in unit,
                    "codec": f"avc1.{codec}",
                }
                for unit in units
            ]
            pictures, faults = shown.driver().execute_async_script(DECODE, chunks)
            assert (pictures, faults) == (len(units), []), topic


#: Of calls; those of tests have smaller ones.
_numbers = count(1000)


def answered(looker, service, numbers=_numbers, **fields):
    """The answer of a service, which is asked again where a busy machine answers too late."""
    return eventually(
        lambda: looker.call(next(numbers), service, **fields).get("answer"), f"{service} does it"
    )


class Run:
    """One recorded session with Foxglove's client at it, and what both have of it."""

    def __init__(self, top):
        path = top / "run.mcap"
        options = ("--record", str(path), "--foxglove", str(tcp_port()))
        with RunningSession("spacejustin", *options, directory=top) as session:
            session.wait_for_flow()
            # Pictures for others never take a core from the session.
            pid = session.pids()["foxglove"]
            assert os.sched_getscheduler(pid) == os.SCHED_IDLE
            url = address(session)
            self._look(FoxgloveClient(url, top / "looker.txt"))
            # A client without the token is refused, and garbage closes a socket of its own.
            unknown = FoxgloveClient(url.replace("token=", "token=x"), top / "unknown sender.txt")
            assert "403" in str(eventually(lambda: unknown.answers("error"), "a refusal"))
            unknown.end()
            # A process that is killed comes again at the same address.
            os.kill(pid, signal.SIGKILL)

            def comes_again():
                again = FoxgloveClient(url, top / "again.txt")
                over = again.process.poll
                eventually(lambda: again.messages() or over() is not None, "messages or its end")
                again.end()
                return again.messages()

            eventually(comes_again, "messages after the kill")
            self.report = session.finish()
        self.received, self.recorded = self.looker.messages(), recorded(path)

    def _look(self, looker):
        self.looker = looker
        try:
            assert looker.services() == ["/camera/select"]
            answer = answered(looker, "/camera/select", camera="head")
            assert answer["round_trip_ms"] > 0
            assert "nose" in looker.call(0, "/camera/select", camera="nose")["failure"]
            wanted = {
                **dict.fromkeys(
                    ("/uplink_video/sent", "/downlink_video/received", "/haptic/up/received"), 60
                ),
                **dict.fromkeys(("/figures", "/camera/static", "/uplink_voice/sent"), 0),
                "/telemetry/ground/received": 0,
            }

            def enough():
                counts = Counter(answer["topic"] for answer in looker.answers("topic"))
                return all(counts[topic] > count for topic, count in wanted.items())

            eventually(enough, "messages of all kinds", pause_s=0.5)
            told = looker.answers("parameters")
            (values,) = [one["parameters"] for one in told if one["id"] == "all"]
            assert {"name": "setup.name", "value": "spacejustin"} in values
        finally:
            looker.end()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return Run(tmp_path_factory.mktemp("foxglove"))


@needs_client
def test_foxgloves_client_gets_what_the_recording_has(run):
    assert_sound(run.report)
    told, zero = run.report["foxglove"]["channels"], {"missed": 0, "dropped": 0}
    lost = {topic: told.get(topic, zero) for topic, *_ in run.received}
    compare(run.received, run.recorded, lost)


@needs_client
@pytest.mark.skipif(browsers.missing() is not None, reason=str(browsers.missing()))
def test_chromium_shows_each_picture_that_foxgloves_client_gets(run):
    assert_decodes(run.received)


@needs_client
def test_over_tls_a_client_leads_a_task_by_services(start, tmp_path):
    session = start(BOARD, "--tasks", "--foxglove", f"0.0.0.0:{tcp_port()}")
    session.wait_for_flow()
    url = address(session)
    assert url.startswith("wss://")
    # Node.js refuses a certificate that nobody told it to trust.
    unknown = FoxgloveClient(url, tmp_path / "unknown sender.txt")
    assert "self-signed" in str(eventually(lambda: unknown.answers("error"), "a refusal"))
    unknown.end()
    (certificate,) = session.temporary.glob("*/*/foxglove.pem")
    watcher = FoxgloveClient(
        address(session, "watch"), tmp_path / "watcher.txt", certificate=certificate
    )
    looker = FoxgloveClient(url, tmp_path / "looker.txt", certificate=certificate)
    try:
        assert looker.services() == [
            *("/camera/select", "/task/select", "/task/start", "/task/abort"),
        ]
        eventually(lambda: watcher.messages(), "messages to watch")
        assert watcher.answers("services") == []
        refusal = looker.call(1, "/task/select", task="dancing")["failure"]
        assert "choose one of " in refusal
        task = refusal.split("choose one of ")[1].split(", ")[0]
        assert "failure" in looker.call(2, "/task/abort")
        numbers = count(3)
        assert answered(looker, "/task/select", numbers, task=task)["round_trip_ms"] > 0

        eventually(
            lambda: "answer" in looker.call(next(numbers), "/task/start"),
            "the robot for the task",
            pause_s=0.5,
        )

        def aborted():
            looker.call(next(numbers), "/task/abort")
            return f"{task}: aborted" in session.ask("task", "list").stdout

        eventually(aborted, "its end")
    finally:
        looker.end()
        watcher.end()
    report = session.finish(sound=True)
    (row,) = report["tasks"]
    assert (row["name"], row["result"]) == (task, "aborted")
    assert report["foxglove"]["calls"] == next(numbers) - 2
