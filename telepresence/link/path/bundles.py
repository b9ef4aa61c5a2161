"""Several frames in one datagram, whole or without what is idle. A core.

docs/wire-formats.md has the layout of both kinds.
"""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from telepresence.link.frame import COUNT_MASK, FrameCodec, Pointers
from telepresence.link.profile import LinkProfile
from telepresence.link.protection.datagrams import COMPACT, OVERHEAD_OCTETS, PACKED, SEGMENT_OCTETS

#: The longest content of a datagram: as long as the longest of a handshake.
MOST_OCTETS = SEGMENT_OCTETS - OVERHEAD_OCTETS
#: Idle frames alone are told after this time, because silence is a loss of signal after 49 ms.
IDLE_NS = 10 * NS_PER_MS
#: A datagram has at most this many frames.
MOST_FRAMES = 64
_COUNT_OCTETS = 3
#: An octet below this is a run of idle frames; the others say what follows of a frame.
_FRAME = 0x80
_SAMPLE, _ZONE, _FULL, _VERBATIM = 0x40, 0x20, 0x10, 0x08
_RUN = 0x80


class Bundling(NamedTuple):
    """What an end wants of its datagrams, if the other end can read them.

    transmit, receive: the profiles of the way out and of the way in. batch: slots of which the
    frames go together. compact: leave out what is idle.
    """

    transmit: LinkProfile
    receive: LinkProfile
    batch: int = 1
    compact: bool = False


class FramePacker:
    """Call `handle_frame` for each frame, then `poll_transmit` until None, and so once a slot.

    compact: leave out what is idle. batch: slots of which the frames go together.
    """

    def __init__(self, profile: LinkProfile, *, batch: int, compact: bool) -> None:
        self._codec = FrameCodec(profile)
        self._idle = Pointers(profile).idle
        self._pointer_octets = 1 if profile.pointer_in_vcid else 2
        self._slot_ns, self._compact = profile.slot_ns, compact
        # A slot's wake-up may be early against one that was late.
        self._wait_ns = (batch - 1) * profile.slot_ns - (profile.slot_ns >> 1)
        self._body = bytearray()
        self._frames = self._run = self._due_ns = self._next = 0
        self._complete: deque[bytes] = deque()

    def handle_frame(self, frame: bytes, now_ns: int) -> None:
        """Take the frame of a slot."""
        if not self._compact:
            self._add(frame, now_ns)
            return
        parsed = self._codec.parse(frame)
        if isinstance(parsed, str):
            # A simulated radio has hit it, and its own count may be wrong.
            count, entry = self._next, bytes((_FRAME | _VERBATIM,)) + frame
        else:
            count, sample, pointer, zone = parsed
            entry = self._entry(sample, pointer, zone)
        if self._body and (count != self._next or self._frames == MOST_FRAMES):
            self._end()
        if not self._body:
            self._body += count.to_bytes(_COUNT_OCTETS, "big")
            self._due_ns, self._frames = now_ns + IDLE_NS, 0
        self._next = count + 1 & COUNT_MASK
        if entry:
            self._add(entry, now_ns)
        else:
            self._run += 1
            self._frames += 1

    def poll_transmit(self, now_ns: int) -> tuple[int, bytes] | None:
        """Return the kind and the content of a datagram, or None."""
        if self._body and now_ns >= self._due_ns:
            self._end()
        if not self._complete:
            return None
        return COMPACT if self._compact else PACKED, self._complete.popleft()

    def _add(self, entry: bytes, now_ns: int) -> None:
        body = self._body
        if len(body) + len(entry) + 1 > MOST_OCTETS:
            count = self._next - 1 & COUNT_MASK
            self._end()
            if self._compact:
                body += count.to_bytes(_COUNT_OCTETS, "big")
        first = not body or (self._compact and len(body) == _COUNT_OCTETS)
        if self._run:
            body.append(self._run - 1)
            self._run = 0
        body += entry
        self._frames += 1
        if first:
            self._due_ns = now_ns + max(0, self._wait_ns)
        if not self._compact and len(body) + len(entry) > MOST_OCTETS:
            self._end()

    def _end(self) -> None:
        if self._run:
            self._body.append(self._run - 1)
        if self._body:
            self._complete.append(bytes(self._body))
        self._body.clear()
        self._frames = self._run = 0

    def _entry(self, sample: bytes | None, pointer: int, zone: bytes) -> bytes:
        """What is sent of a frame; nothing of an idle one."""
        used = zone.rstrip(b"\0")
        if pointer == self._idle and not used:
            return b"" if sample is None else bytes((_FRAME | _SAMPLE,)) + sample
        full = len(used) == len(zone)
        flags = _FRAME | _ZONE | _FULL * full | _SAMPLE * (sample is not None)
        octets = self._pointer_octets
        length = b"" if full else len(used).to_bytes(octets, "big")
        return bytes((flags,)) + pointer.to_bytes(octets, "big") + length + (sample or b"") + used


class FrameUnpacker:
    """Returns the frames of datagrams. No state."""

    def __init__(self, profile: LinkProfile) -> None:
        self._codec = FrameCodec(profile)
        self._profile = profile
        self._octets = 1 if profile.pointer_in_vcid else 2
        self._most_pointer = (1 << (5 if profile.pointer_in_vcid else 11)) - 1

    def unpack(self, kind: int, body: bytes) -> tuple[bytes, ...] | None:
        """Return the frames of a datagram's content; None: it is malformed."""
        if kind == COMPACT:
            return self._unpack_compact(body)
        size = self._profile.frame_octets
        if not body or len(body) % size or len(body) > MOST_FRAMES * size:
            return None
        return tuple(body[at : at + size] for at in range(0, len(body), size))

    def _unpack_compact(self, body: bytes) -> tuple[bytes, ...] | None:
        frames: list[bytes] = []
        at, end = _COUNT_OCTETS, len(body)
        first = int.from_bytes(body[:_COUNT_OCTETS], "big")
        while at < end:
            head = body[at]
            at += 1
            run = head + 1 if head < _RUN else 1
            if len(frames) + run > MOST_FRAMES:
                return None
            if head < _RUN:
                count = first + len(frames)
                frames += (self._codec.pack_idle(count + idle, None) for idle in range(run))
                continue
            taken = self._frame(head, body, at, first + len(frames))
            if taken is None:
                return None
            frame, at = taken
            frames.append(frame)
        return tuple(frames) or None

    def _frame(self, head: int, body: bytes, at: int, count: int) -> tuple[bytes, int] | None:
        """Return the frame at `at`, and where the next entry begins; None: it is malformed."""
        profile, codec, octets = self._profile, self._codec, self._octets
        if head == _FRAME | _VERBATIM:
            end = at + profile.frame_octets
            return None if end > len(body) else (body[at:end], end)
        has_zone, full = head & _ZONE, head & _FULL
        has_sample = head & _SAMPLE
        if head & 0x0F or (full and not has_zone) or not (has_zone or has_sample):
            return None
        size = profile.packet_zone_octets if has_sample else profile.largest_zone_octets
        pointer = 0
        length = size if full else 0
        if has_zone:
            pointer = int.from_bytes(body[at : at + octets], "big")
            at += octets
            if not full:
                length = int.from_bytes(body[at : at + octets], "big")
                at += octets
        sample_end = at + (profile.insert_octets if has_sample else 0)
        end = sample_end + length
        if pointer > self._most_pointer or length > size or end > len(body):
            return None
        sample = body[at:sample_end] if has_sample else None
        if not has_zone:
            return codec.pack_idle(count, sample), end
        return codec.pack(count, sample, pointer, body[sample_end:end].ljust(size, b"\0")), end
