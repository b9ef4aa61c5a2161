"""One recording for each run of a task, made by the session's recorder."""

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

from pipelines.session.recorder_control import RecorderLink
from pipelines.session.recorder_requests import (
    START,
    STATE,
    STOP,
    RecordAnswer,
    RecordingWish,
    RecordRequest,
)

#: A recorder that was killed is there again within this time.
_RETURN_S, _AGAIN_S = 4.0, 0.1
_NO_ANSWER = "the recorder does not answer"


class RunFiles:
    """Asks the recorder in a thread, because it may take seconds to end a file.

    directory: of the files, `run-003-aiming.mcap`; None: no files, and `recording` is what was
    asked for. What an earlier life has left open is ended. Recordings of others are left alone.

    recording: whether a run is recorded. unrecorded: runs without a file; why: of the newest one.
    """

    def __init__(self, session: str, directory: str | None) -> None:
        self.recording = False
        self.unrecorded, self.why = 0, ""
        self._session = session
        self._directory = None if directory is None else Path(directory)
        self._asked: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._wanted = self._closing = False
        self._thread: threading.Thread | None = None
        if directory is not None:
            self._thread = threading.Thread(target=self._work, daemon=True)
            self._thread.start()
            self._asked.put(self._end)

    def record(self, *, on: bool, task: str, run: int) -> None:
        """Begin or end the file of a run. The same again changes nothing."""
        if on is self._wanted:
            return
        self._wanted = on
        if self._directory is None:
            self.recording = on
        elif on:
            file = self._directory / f"run-{run:03d}-{task}.mcap"
            wish = RecordingWish(file=str(file), command=f"task {task}, run {run}")
            self._asked.put(lambda: self._begin(wish))
        else:
            self._asked.put(self._end)

    def close(self) -> None:
        """End what is being recorded. With the session, the recorder ends it, too."""
        self._closing = True
        if self._thread is not None:
            self.record(on=False, task="", run=0)
            self._asked.put(None)
            self._thread.join(3.0)

    def _work(self) -> None:
        while (work := self._asked.get()) is not None:
            work()

    def _begin(self, wish: RecordingWish) -> None:
        answer = self._ask(RecordRequest(record=START, wish=wish, overwrite=True))
        if answer is None or not answer.ok:
            self.unrecorded += 1
            self.why = _NO_ANSWER if answer is None else answer.error
        # A run is done without its file rather than not at all.
        self.recording = True

    def _end(self) -> None:
        now = self._ask(RecordRequest(record=STATE))
        if now is not None and now.file and Path(now.file).parent == self._directory:
            self._ask(RecordRequest(record=STOP))
        self.recording = False

    def _ask(self, request: RecordRequest) -> RecordAnswer | None:
        """Return the recorder's answer; None if there is none, also not from its next life."""
        until_s = time.monotonic() + _RETURN_S
        while True:
            try:
                link = RecorderLink(self._session)
                try:
                    return link.ask(request)
                finally:
                    link.close()
            except OSError:
                if self._closing or time.monotonic() > until_s:
                    return None
            time.sleep(_AGAIN_S)
