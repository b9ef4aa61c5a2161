"""Decides which requests to record and to stop are carried out. A core."""

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.session.recording_requests import RecordingOptions, StartRecording

#: A held recording goes on for this long without its terminal: that may come back.
HOLD_NS = 5 * NS_PER_S


class RecorderRequests:
    """options: of the present recording. A held recording ends when no terminal holds it any more.

    A terminal is a connection, known by its number. Call `poll_abandoned` at least once a second.
    """

    def __init__(self, options: RecordingOptions | None, now_ns: int) -> None:
        self.options = options
        self._holders: set[int] = set()
        self._free_ns = now_ns

    def handle_start(self, request: StartRecording, terminal: int) -> bool:
        """True: begin to record, and report with `handle_started`. ConfigError: it must not."""
        if self.options is None:
            return True
        if not self.options.held or request.options != self.options:
            raise ConfigError(f"the session is being recorded already, to {self.options.file}")
        # Its own terminal again, after this process was restarted.
        self._holders.add(terminal)
        return False

    def handle_started(self, options: RecordingOptions, terminal: int) -> None:
        """The recording has begun."""
        self.options = options
        if options.held:
            self._holders.add(terminal)

    def handle_stop(self) -> None:
        """End the recording, unless this raises ConfigError."""
        if self.options is None:
            raise ConfigError("the session is not being recorded")
        self.options = None
        self._holders.clear()

    def handle_closed(self, terminal: int, now_ns: int) -> None:
        """A terminal has gone."""
        self._holders.discard(terminal)
        self._free_ns = now_ns

    def poll_abandoned(self, now_ns: int) -> bool:
        """Whether to stop a held recording, because its terminal has gone for long."""
        if self.options is None or not self.options.held or self._holders:
            self._free_ns = now_ns
        return now_ns - self._free_ns >= HOLD_NS
