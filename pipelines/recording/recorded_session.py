"""What a session sent, read back from its recording, and the caps to send it again. A core.

All instants are on the clock of the recorded session.
"""

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError, one_of
from kontur_av.media import BLOCK_NS, VIDEO_CODECS, VideoCodec
from kontur_av.sources.instants import RisingInstants
from kontur_av.streams.budget import Pacer
from pipelines.recording.channels import RECEIVED, SENT
from pipelines.recording.joined import JoinedMessage, JoinedRecording
from pipelines.recording.metadata import RecordingMetadata
from pipelines.recording.recorded_messages import (
    AUDIO,
    HAPTIC_SAMPLES,
    NO_SAMPLE,
    SAMPLE,
    SPACE_PACKET,
    UNIT_METADATA,
    VIDEO,
    RecordedPacket,
    RecordedPicture,
    RecordedSound,
    UnitMetadata,
    unpack,
    unpack_haptics,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY

#: From picture to picture, until a stream has shown its own.
_PICTURE_NS = NS_PER_S // 15
#: By the end that sends packets: the stream that carries them.
_STREAMS = {Segment.SPACE.value: TELECOMMAND, Segment.GROUND.value: TELEMETRY}


class SentUnit(NamedTuple):
    """An access unit or an Opus packet, and the instant of its capture."""

    capture_ns: int
    data: bytes
    key: bool = False
    codec: VideoCodec = "h264"


class SentPacket(NamedTuple):
    """A space packet, and the instant at which it was sent."""

    sent_ns: int
    data: bytes


@dataclass(kw_only=True)
class RecordedSession:
    """A recording.

    pictures, voices: by stream, as sent. received: by stream, the access units that its receiver
        got. haptics: by direction (`up`, `down`), the cycles in which its sender sent a sample, in
        order; dtype `SAMPLE`. packets: by stream, telecommands and telemetry as sent.
    missing: by channel, messages of these that are not in its files.
    moved: by channel, messages whose instant was not after the one before; they got a later one.
    parts: its files.
    """

    metadata: RecordingMetadata
    parts: int = 1
    pictures: dict[str, list[SentUnit]] = field(default_factory=dict)
    voices: dict[str, list[SentUnit]] = field(default_factory=dict)
    received: dict[str, list[bytes]] = field(default_factory=dict)
    haptics: dict[str, NDArray[np.void]] = field(default_factory=dict)
    packets: dict[str, list[SentPacket]] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    moved: dict[str, int] = field(default_factory=dict)

    @property
    def instants_ns(self) -> tuple[int, int]:
        """The first and the last instant of anything that was sent."""
        media = (*self.pictures.values(), *self.voices.values())
        found = [unit.capture_ns for units in media for unit in (units[0], units[-1])]
        found += [int(rows["time_ns"][at]) for rows in self.haptics.values() for at in (0, -1)]
        found += [one.sent_ns for each in self.packets.values() for one in (each[0], each[-1])]
        return min(found), max(found)

    def begin(self, seconds: float) -> "RecordedSession":
        end_ns = self.instants_ns[0] + round(seconds * NS_PER_S)
        media = {
            field: {
                name: early
                for name, sent in getattr(self, field).items()
                if (early := [one for one in sent if one[0] < end_ns])
            }
            for field in ("pictures", "voices", "packets")
        }
        haptics = {key: rows[rows["time_ns"] < end_ns] for key, rows in self.haptics.items()}
        kept = {key: rows for key, rows in haptics.items() if len(rows)}
        return replace(self, haptics=kept, **media)  # type: ignore[arg-type]


def read_session(recording: JoinedRecording) -> RecordedSession:
    """What was sent, of a torn recording as far as it goes.

    Raises ProtocolError for one without its facts, or in which nothing was sent.
    """
    if recording.metadata is None:
        raise ProtocolError("its facts are lost")
    messages: dict[str, list[JoinedMessage]] = defaultdict(list)
    for message in recording.messages():
        if _is_replayed(message):
            messages[message.topic].append(message)
    session = _session(recording.metadata, messages)
    session.parts = len(recording.parts)
    if not (session.pictures or session.voices or session.haptics or session.packets):
        raise ProtocolError("nothing that was sent is in it")
    return session


def _is_replayed(found: JoinedMessage) -> bool:
    """Whether the message is needed: what was sent, and which pictures came."""
    way = found.topic.removesuffix("/facts").rpartition("/")[2]
    video = found.schema in (VIDEO.full_name, UNIT_METADATA.full_name)
    return (way == SENT and not found.topic.startswith("/link/")) or (way == RECEIVED and video)


def _session(
    metadata: RecordingMetadata, messages: Mapping[str, list[JoinedMessage]]
) -> RecordedSession:
    session = RecordedSession(metadata=metadata)
    for topic, found in messages.items():
        schema = found[0].schema
        instants = RisingInstants(BLOCK_NS if schema == AUDIO.full_name else _PICTURE_NS)
        name, _, way = topic.strip("/").rpartition("/")
        if schema == VIDEO.full_name:
            units = _pictures(found, messages.get(f"{topic}/facts", []), instants)
            if way == SENT:
                session.pictures[name] = units
            else:
                session.received[name] = [unit.data for unit in units]
        elif schema == AUDIO.full_name:
            session.voices[name] = [
                SentUnit(at_ns, unpack(RecordedSound, one.data).data)
                for one, at_ns in instants.redate(found, lambda each: each.session_ns)
            ]
        elif schema == HAPTIC_SAMPLES.full_name:
            rows = _sent_rows([unpack_haptics(one.data) for one in found])
            if len(rows):
                session.haptics[name.rpartition("/")[2]] = rows
        elif schema == SPACE_PACKET.full_name:
            packets = [unpack(RecordedPacket, one.data) for one in found]
            # Older recordings have the stream's name, whatever the packet is.
            stream = _STREAMS.get(name.partition("/")[2], name)
            sent = [SentPacket(packet.session_ns, packet.data) for packet in packets]
            session.packets[stream] = sorted(session.packets.get(stream, []) + sent)
        else:
            continue
        if way == SENT and instants.moved:
            session.moved[topic] = instants.moved
        if way == SENT and (missing := _missing(found)):
            session.missing[topic] = missing
    return session


def _pictures(
    found: list[JoinedMessage], told: list[JoinedMessage], instants: RisingInstants
) -> list[SentUnit]:
    """The access units of a stream, without what the recorder has added to them."""
    metadata = defaultdict[tuple[int, int], deque[UnitMetadata]](deque)
    for one in told:
        metadata[one.part, one.sequence].append(unpack(UnitMetadata, one.data))
    kept = []
    for one in found:
        picture = unpack(RecordedPicture, one.data)
        data = picture.data
        fact = None
        if its := metadata[one.part, one.sequence]:
            # A key picture that the recorder put ahead has the number of the unit before.
            fact = its.popleft()
            if fact.added:
                continue
            # In front of it are parameter sets for a reader that begins here.
            data = data[-fact.octets :]
        key = fact is not None and fact.key
        codec = one_of(picture.format, VIDEO_CODECS, "recording: codec")
        kept.append((one.session_ns, data, key, codec))
    dated = instants.redate(kept, lambda each: each[0])
    return [SentUnit(at_ns, data, key, codec) for (_, data, key, codec), at_ns in dated]


def _sent_rows(blocks: list[NDArray[np.void]]) -> NDArray[np.void]:
    """The cycles with a sample; all of them where no number is known."""
    kind = blocks[0].dtype if blocks else SAMPLE
    rows = np.concatenate([np.empty(0, kind), *(each for each in blocks if each.dtype == kind)])
    rows = rows[np.argsort(rows["time_ns"], kind="stable")]
    numbered = rows["sequence"] != NO_SAMPLE
    return rows[numbered] if numbered.any() else rows


def _missing(found: list[JoinedMessage]) -> int:
    """Gaps in the sequence numbers; a smaller number is that of a process started again."""
    numbers = [one.sequence for one in found]
    return sum(after - before - 1 for before, after in pairwise(numbers) if after > before)


#: Under a lower cap a packet may wait so much longer than under the recorded one.
MOST_MORE_NS = 100 * NS_PER_MS
#: Caps are named in steps of this.
_STEP_BPS = 1000


def longest_wait_ns(
    units: Sequence[tuple[int, int]], *, cap_bps: int, channel_bps: int, payload_octets: int
) -> int:
    """Return the longest that a packet waits for its release.

    units: (instant, octets) of each, in order. channel_bps: of the link, for media.
    payload_octets: the largest payload of a packet.
    """
    pacer = Pacer(cap_bps=cap_bps, channel_bps=max(cap_bps, channel_bps))
    largest = min(payload_octets, pacer.max_payload_octets)
    for at_ns, octets in units:
        _drain(pacer, at_ns)
        sizes = [largest] * (octets // largest) + [octets % largest] * bool(octets % largest)
        pacer.handle_access_unit([b""] * len(sizes), sizes, at_ns)
    _drain(pacer, None)
    return pacer.longest_wait_ns


def _drain(pacer: Pacer, until_ns: int | None) -> None:
    while (due_ns := pacer.poll_timeout()) is not None:
        if until_ns is not None and due_ns >= until_ns:
            return
        pacer.poll_transmit(due_ns)


def cap_needed_bps(
    units: Sequence[tuple[int, int]],
    *,
    cap_bps: int,
    recorded_bps: int,
    channel_bps: int,
    payload_octets: int,
    speed: float = 1.0,
) -> int:
    """Return `cap_bps` if it carries the units about as soon as the cap of their recording did.

    Else the lowest cap that does, in whole kbit/s. The arguments of `longest_wait_ns`; speed: how
    much faster they come than when they were recorded.
    """

    def wait_ns(cap_bps: int, units: Sequence[tuple[int, int]]) -> int:
        return longest_wait_ns(
            units, cap_bps=cap_bps, channel_bps=channel_bps, payload_octets=payload_octets
        )

    if cap_bps >= recorded_bps * max(speed, 1.0):
        return cap_bps
    most_ns = wait_ns(recorded_bps, units) + MOST_MORE_NS
    faster = [(round(at_ns / speed), octets) for at_ns, octets in units]
    if wait_ns(cap_bps, faster) <= most_ns:
        return cap_bps
    low, high = cap_bps // _STEP_BPS, -(-round(recorded_bps * max(speed, 1.0)) // _STEP_BPS)
    while high - low > 1:
        middle = (low + high) // 2
        if wait_ns(middle * _STEP_BPS, faster) <= most_ns:
            high = middle
        else:
            low = middle
    return high * _STEP_BPS
