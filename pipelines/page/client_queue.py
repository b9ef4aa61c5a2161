"""What waits for one page, and what is left out when it does not keep up. A core.

| what | depth | when full |
|---|---|---|
| answers | 64 | the socket is closed: nobody asks so much without reading |
| texts of a kind (state, figures) | 1 | the newest counts |
| previews, by input | 1 | the newest counts |
| haptic blocks, by end | 25 (0.5 s) | the oldest goes |
| sound, by stream | 15 (0.3 s) | the oldest goes |
| access units, by stream | 45 and 1 MiB, without a replay | all go; the stream waits for a replay |
"""

from collections import deque
from collections.abc import Sequence

_MOST_ANSWERS = 64
_MOST_HAPTICS = 25
_MOST_SOUNDS = 15
_MOST_UNITS = 45
_MOST_UNIT_OCTETS = 1 << 20


class _Stream:
    """The units of one stream that wait."""

    def __init__(self) -> None:
        self.replay: deque[bytes] = deque()
        self.units: deque[bytes] = deque()
        self.octets = 0
        #: Whether units count; False until a replay has brought a picture to start at.
        self.open = False


class ClientQueue:
    """The messages for one page. After each input, send what `poll_transmit` returns.

    left_out: units and blocks that were dropped. overflowed: the page must be given up.
    """

    def __init__(self, video_streams: Sequence[int]) -> None:
        self.left_out = 0
        self.overflowed = False
        self._answers: deque[bytes | str] = deque()
        self._texts: dict[str, str] = {}
        self._haptics: dict[int, deque[bytes]] = {}
        self._sounds: dict[int, deque[bytes]] = {}
        self._previews: dict[int, bytes] = {}
        self._streams = {index: _Stream() for index in video_streams}

    def handle_answer(self, message: bytes | str) -> None:
        """An answer or a pong, which goes first."""
        if len(self._answers) >= _MOST_ANSWERS:
            self.overflowed = True
        else:
            self._answers.append(message)

    def handle_text(self, kind: str, text: str) -> None:
        """A text that replaces an older one of its kind."""
        self._texts[kind] = text

    def handle_haptics(self, end: int, block: bytes) -> None:
        """A block of haptic rows."""
        self._append(self._haptics.setdefault(end, deque()), block, _MOST_HAPTICS)

    def handle_sound(self, stream: int, block: bytes) -> None:
        """A block of sound."""
        self._append(self._sounds.setdefault(stream, deque()), block, _MOST_SOUNDS)

    def handle_preview(self, preview: int, message: bytes) -> None:
        """A small picture."""
        if preview in self._previews:
            self.left_out += 1
        self._previews[preview] = message

    def handle_unit(self, stream: int, message: bytes) -> None:
        """An access unit. Before a replay, and after a stall, it is left out."""
        waiting = self._streams[stream]
        if not waiting.open:
            self.left_out += 1
            return
        waiting.units.append(message)
        waiting.octets += len(message)
        if len(waiting.units) > _MOST_UNITS or waiting.octets > _MOST_UNIT_OCTETS:
            self.left_out += len(waiting.units) + len(waiting.replay)
            waiting.units.clear()
            waiting.replay.clear()
            waiting.octets = 0
            waiting.open = False

    def needs_replay(self, stream: int) -> bool:
        """Whether the page has drained all that waited, and waits for a picture to start at."""
        return not self._streams[stream].open

    def handle_replay(self, stream: int, messages: Sequence[bytes]) -> None:
        """The units with which the stream begins; those that come later follow."""
        waiting = self._streams[stream]
        waiting.replay.extend(messages)
        waiting.open = True

    def poll_transmit(self) -> bytes | str | None:
        """Return the next message to send, or None."""
        if self._answers:
            return self._answers.popleft()
        for kind in self._texts:
            return self._texts.pop(kind)
        for blocks in (*self._haptics.values(), *self._sounds.values()):
            if blocks:
                return blocks.popleft()
        for waiting in self._streams.values():
            if waiting.replay:
                return waiting.replay.popleft()
            if waiting.units:
                message = waiting.units.popleft()
                waiting.octets -= len(message)
                return message
        for preview in self._previews:
            return self._previews.pop(preview)
        return None

    def _append(self, blocks: deque[bytes], block: bytes, most: int) -> None:
        blocks.append(block)
        if len(blocks) > most:
            blocks.popleft()
            self.left_out += 1
