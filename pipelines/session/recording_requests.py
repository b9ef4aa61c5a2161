"""What a session's recorder is asked, and a recording that is held from outside."""

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import make_session_root, replace_file, session_root
from pipelines.session.requests import RequestClient
from telepresence.malformed import MALFORMED

#: The name of the recorder's socket.
RECORDER_SOCKET = "recorder"
#: How long a recorder may take to answer: it writes a slow disk's file to its end first.
RECORDER_S = 15.0
#: A recorder that was killed is there again within this time.
RETURN_S = 4.0


@dataclass(frozen=True, kw_only=True)
class PartLimits:
    """When a new part begins: after `ns`, or with `octets`."""

    ns: int = 600 * NS_PER_S
    octets: int = 256_000_000


class RecordingOptions(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is to be recorded, and into which file.

    file: absolute path of the first part. link_frames: with every frame of the radio link.
    cameras: "all", "carried", or "" as the setup has it. part_s, part_mb: when a new part begins.
    command: the command line that wished it.
    held: end the recording when its terminal has gone.
    """

    file: str
    link_frames: bool = False
    cameras: str = ""
    part_s: float = 600.0
    part_mb: float = 256.0
    command: str = ""
    held: bool = False

    @property
    def limits(self) -> PartLimits:
        return PartLimits(ns=round(self.part_s * NS_PER_S), octets=round(self.part_mb * 1e6))


class StartRecording(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Begin to record. overwrite: replace a recording that is there."""

    options: RecordingOptions
    overwrite: bool = False


class StopRecording(msgspec.Struct, frozen=True, tag=True):
    """End the recording."""


class AskRecording(msgspec.Struct, frozen=True, tag=True):
    """Ask how it goes."""


RecordRequest = StartRecording | StopRecording | AskRecording


class RecordAnswer(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """How it goes, or how the newest recording went.

    file: that is being written; "" if nothing is recorded. files: how many parts there are. lost:
    messages that are in none of them. cameras: which are recorded, and what they need.
    """

    file: str = ""
    files: int = 0
    messages: int = 0
    lost: int = 0
    fault: str = ""
    cameras: str = ""


_REQUEST = "recording"


def write_request(session: str, options: RecordingOptions) -> None:
    """Keep what is to be recorded, for this and the next starts of the recorder."""
    make_session_root(session)
    replace_file(session_root(session) / _REQUEST, msgspec.json.encode(options))


def read_request(session: str) -> RecordingOptions | None:
    with suppress(OSError, *MALFORMED):
        octets = (session_root(session) / _REQUEST).read_bytes()
        return msgspec.json.decode(octets, type=RecordingOptions)
    return None


def remove_request(session: str) -> None:
    (session_root(session) / _REQUEST).unlink(missing_ok=True)


def begin_recording(session: str, options: RecordingOptions, *, overwrite: bool) -> RequestClient:
    """Return the connection; a `held` recording ends some seconds after it is closed."""
    with ExitStack() as stack:
        try:
            client = stack.enter_context(RequestClient(session, RECORDER_SOCKET, RECORDER_S))
            client.ask(StartRecording(options=options, overwrite=overwrite), RecordAnswer)
        except OSError as error:
            raise ConfigError(f"the recorder of {session} does not answer: {error}") from None
        stack.pop_all()
    return client


#: How often it asks whether the recorder is still there.
_LOOK_S = 0.2


def hold_recording(
    client: RequestClient,
    session: str,
    options: RecordingOptions,
    ended: Callable[[], bool],
    seconds: float | None,
) -> RecordAnswer | None:
    """Wait for the end; what was recorded, or None if the session has ended."""
    end_s = None if seconds is None else time.monotonic() + seconds
    fault = ""
    while True:
        left_s = _LOOK_S if end_s is None else min(_LOOK_S, end_s - time.monotonic())
        time.sleep(max(0.0, left_s))
        over = ended() or (end_s is not None and time.monotonic() >= end_s)
        try:
            answer = client.ask(AskRecording(), RecordAnswer)
            if over and answer.file:
                answer = client.ask(StopRecording(), RecordAnswer)
        except OSError:
            client.close()
            if (returned := _returned(session, options)) is None:
                return None
            client = returned
            continue
        if over or not answer.file:
            client.close()
            return answer
        if answer.fault and answer.fault != fault:
            print(f"kontur-av: {answer.fault}; the recorder tries again", file=sys.stderr)
        fault = answer.fault


def _returned(session: str, options: RecordingOptions) -> RequestClient | None:
    """The recorder that the launcher has started again; None if it does not come."""
    end_s = time.monotonic() + RETURN_S
    while time.monotonic() < end_s:
        with suppress(ConfigError):
            return begin_recording(session, options, overwrite=False)
        time.sleep(0.1)
    return None
