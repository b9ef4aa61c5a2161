"""A small but complete recording: every channel of a session, written by the project's own writer.

Pictures are numbered (`marks`), coded by the real encoder, with irregular frame times, and change
their size half-way. The robot touches the board from time to time. A part begins with a key picture
of each stream. The session's clock and wall time differ by `WALL_OFFSET_NS`.
"""

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, CaptureStamp, VideoFrame
from pipelines.bench.course import marks
from pipelines.hand.haptic_trace import flags_of
from pipelines.recording.channels import channels_of
from pipelines.recording.mcap_stream import McapStream
from pipelines.recording.metadata import LIBRARY, METADATA, RecordingMetadata
from pipelines.recording.packet_words import PacketWords
from pipelines.recording.recorded_messages import (
    NO_SAMPLE,
    SAMPLE,
    CarriedOctets,
    ChannelLoss,
    LinkReceived,
    LinkSent,
    LogLevel,
    LogLine,
    QueueState,
    RecordedEvent,
    RecordedFigure,
    RecordedFrames,
    RecordedMetrics,
    RecordedPacket,
    RecordedPicture,
    RecordedSound,
    RecorderLosses,
    UnitMetadata,
    pack,
    pack_haptics,
)
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet

MS = 1_000_000
S = 1000 * MS
BEGIN_NS = 5_000 * S
WALL_OFFSET_NS = 1_800_000_000 * S - BEGIN_NS
WIDTH, HEIGHT = 320, 240
WORDS = PacketWords(built_in_dictionary())
SETUP_TOML = """\
name = "spacejustin"
cameras = ["stereo", "static", "head"]

[uplink_video]
cap_kbps = 85
size = "320x240"

[uplink_voice]
cap_kbps = 8

[downlink_video]
cap_kbps = 512
size = "320x240"

[downlink_voice]
cap_kbps = 64
"""
METADATA_OF_SYNTHETIC = RecordingMetadata(
    session="kontur-1",
    setup="spacejustin",
    setup_toml=SETUP_TOML,
    version="0.1.0",
    seed=1,
    command="kontur-av stream --setup spacejustin --record a.mcap",
    part=1,
    session_ns=BEGIN_NS,
    wall_ns=BEGIN_NS + WALL_OFFSET_NS,
)
#: One way through the link: of media, and of haptics in cycles of 1 ms.
LINK_NS, LINK_CYCLES = 40 * MS, 11
#: From capture to the instant at which a message is published, without the link.
PUBLISHED_NS = 7 * MS
#: The robot touches the board for `TOUCH_S` in every `TOUCH_EVERY_S`.
TOUCH_EVERY_S, TOUCH_S = 1.0, 0.3
#: Of the received pictures of the uplink, this one is missing, and the next one shows it.
LOST_PICTURE = 20
VIDEO = {"uplink_video": 85_000, "downlink_video": 512_000}
VOICES = {"uplink_voice": 8_000, "downlink_voice": 64_000}
CAMERA, CAMERA_BPS = "head", 30_000


@dataclass(frozen=True)
class Coded:
    """An access unit with the number of its picture, instants on the session's clock."""

    number: int
    capture_ns: int
    data: bytes
    key: bool
    width: int
    height: int


@dataclass(frozen=True)
class Told:
    """A message as it was written; log_ns: on the session's clock."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True, kw_only=True)
class SyntheticRecording:
    """paths: the parts. told: messages by channel, in order. units: what was coded, by stream or
    camera. haptics: by channel, dtype `SAMPLE`. contacts: (first, last) instant, session clock.
    """

    paths: list[Path]
    told: dict[str, list[Told]]
    units: dict[str, list[Coded]]
    haptics: dict[str, np.ndarray]
    contacts: list[tuple[int, int]]
    capabilities: RecordingMetadata = field(default=METADATA_OF_SYNTHETIC)


def wall_ns(session_ns):
    return session_ns + WALL_OFFSET_NS


def part_path(path, part):
    """FILE.mcap, FILE-2.mcap, …"""
    return path if part == 1 else path.with_name(f"{path.stem}-{part}{path.suffix}")


def write_recording(
    path, *, seconds=3.0, parts=1, link_frames=False, end=True, components=(), more=()
):
    """Write a recording of equally long parts; end: the last part has its summary.

    components: of the session. more: further messages.
    """
    begins = tuple(BEGIN_NS + round(part * seconds * S / parts) for part in range(parts))
    units = {
        name: coded(cap, seconds, begins, number)
        for number, (name, cap) in enumerate((VIDEO | {CAMERA: CAMERA_BPS}).items())
    }
    haptics, contacts = haptic_cycles(seconds)
    topology = topology_of(BUILT_IN["spacejustin"], components=components)
    rows = {row.topic: row for row in channels_of(topology, link_frames=link_frames)}
    messages = [
        *media_messages(units, seconds),
        *haptic_messages(haptics),
        *command_messages(seconds, contacts),
        *link_messages(seconds, link_frames),
        *more,
    ]
    # By the part of the instant of capture, so that a part begins with its key pictures.
    messages.sort(key=lambda told: told.publish_ns)
    paths = []
    for part, begin_ns in enumerate(begins, start=1):
        end_ns = begins[part] if part < parts else None
        of_part = [
            told
            for told in messages
            if (part == 1 or told.log_ns >= begin_ns) and (end_ns is None or told.log_ns < end_ns)
        ]
        paths.append(part_path(Path(path), part))
        capabilities = replace(
            METADATA_OF_SYNTHETIC, part=part, session_ns=begin_ns, wall_ns=wall_ns(begin_ns)
        )
        paths[-1].write_bytes(
            octets_of_part(rows.values(), capabilities, of_part, end or part < parts)
        )
    by_topic = defaultdict(list)
    for told in sorted(messages, key=lambda told: told.log_ns):
        by_topic[told.topic].append(told)
    return SyntheticRecording(
        paths=paths, told=dict(by_topic), units=units, haptics=haptics, contacts=contacts
    )


def octets_of_part(rows, capabilities, messages, end):
    stream, octets, now_ns = McapStream(library=LIBRARY), bytearray(), 0
    stream.handle_metadata(METADATA, capabilities.items())
    numbers = {}
    for row in rows:
        numbers[row.topic] = row.number
        stream.handle_channel(*row.records())
    for told in messages:
        now_ns = told.publish_ns
        octets += b"".join(iter(lambda at_ns=now_ns: stream.poll_transmit(at_ns), None))
        stream.handle_message(
            numbers[told.topic],
            told.data,
            log_ns=wall_ns(told.log_ns),
            publish_ns=wall_ns(told.publish_ns),
            sequence=told.sequence,
            now_ns=now_ns,
        )
    if end:
        stream.handle_end()
    return bytes(octets) + b"".join(iter(lambda: stream.poll_transmit(now_ns), None))


@lru_cache(maxsize=16)
def coded(cap_bps, seconds, begins, seed):
    """Numbered pictures about 15 times a second; key pictures where a part begins."""
    random = np.random.default_rng(seed)
    found, at_ns, begins = [], BEGIN_NS, [*begins]
    half_ns = BEGIN_NS + round(seconds * S / 2)
    encoder, small = None, None
    while at_ns < BEGIN_NS + seconds * S:
        key = bool(begins) and at_ns >= begins[0]
        if key:
            begins.pop(0)
        if small != (at_ns >= half_ns):
            small = at_ns >= half_ns
            size = (WIDTH * 3 // 4, HEIGHT * 3 // 4) if small else (WIDTH, HEIGHT)
            encoder = H264Encoder(
                width=WIDTH, height=HEIGHT, fps=15, cap_bps=cap_bps, coded_size=size
            )
        number = len(found)
        picture = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
        picture[:HEIGHT] = np.add.outer(np.arange(HEIGHT) // 4, np.arange(WIDTH) // 4 + number)
        marks.draw_number(picture, number)
        stamp = CaptureStamp(at_ns, number, "synthetic")
        unit = encoder.encode(VideoFrame(picture, stamp), Coding(keyframe=key))
        found.append(Coded(number, at_ns, unit.data, unit.keyframe, *encoder.unit_size))
        next_ns = at_ns + int(random.integers(30 * MS, 100 * MS))
        # The first picture of a part is exactly where the part begins.
        at_ns = min(next_ns, *begins[:1]) if begins else next_ns
    return found


@lru_cache(maxsize=4)
def spoken(bitrate_bps, seconds):
    """Opus packets of a tone, 20 ms each."""
    encoder = OpusEncoder(bitrate_bps=bitrate_bps)
    count = int(seconds * AUDIO_CLOCK_HZ / BLOCK_SAMPLES)
    phase = np.arange(count * BLOCK_SAMPLES) * (2 * np.pi * 440 / AUDIO_CLOCK_HZ)
    sound = (8000 * np.sin(phase)).astype(np.int16).reshape(count, BLOCK_SAMPLES)
    return [encoder.encode(block) for block in sound]


def media_messages(units, seconds):
    """Pictures with their facts, and sound, as sent and as received."""
    for name, found in units.items():
        if name == CAMERA:
            for unit in found:
                yield picture(f"/camera/{name}", unit, unit.number, 0)
            continue
        arrived = [unit for unit in found if name != "uplink_video" or unit.number != LOST_PICTURE]
        for way, units_of, delay_ns in (("sent", found, 0), ("received", arrived, LINK_NS)):
            for number, unit in enumerate(units_of):
                broken = number == LOST_PICTURE and len(units_of) < len(found)
                yield picture(f"/{name}/{way}", unit, number, delay_ns)
                yield capabilities_of(f"/{name}/{way}", unit, number, delay_ns, shows_loss=broken)
    for name, bitrate_bps in VOICES.items():
        for number, packet in enumerate(spoken(bitrate_bps, seconds)):
            at_ns = BEGIN_NS + number * 20 * MS
            data = pack(RecordedSound(wall_ns=wall_ns(at_ns), data=packet))
            for way, delay_ns in (("sent", 0), ("received", LINK_NS)):
                yield told(f"/{name}/{way}", at_ns, number, data, delay_ns)


def told(topic, log_ns, sequence, data, delay_ns=0):
    """A message that is published `delay_ns` later than usual."""
    return Told(topic, log_ns, log_ns + PUBLISHED_NS + delay_ns, sequence, data)


def picture(topic, unit, sequence, delay_ns):
    name = topic.split("/")[2 if topic.startswith("/camera") else 1]
    value = RecordedPicture(wall_ns=wall_ns(unit.capture_ns), frame_id=name, data=unit.data)
    return told(topic, unit.capture_ns, sequence, pack(value), delay_ns)


def capabilities_of(topic, unit, sequence, delay_ns, *, shows_loss=False):
    value = UnitMetadata(
        capture_ns=unit.capture_ns,
        key=unit.key,
        damaged=False,
        shows_loss=shows_loss,
        refused=False,
        dated=True,
        width_px=unit.width,
        height_px=unit.height,
        octets=len(unit.data),
    )
    return told(f"{topic}/facts", unit.capture_ns, sequence, pack(value), delay_ns)


def haptic_cycles(seconds):
    """The cycles of both ends by channel, and when the robot touched the board."""
    count = int(seconds * 1000)
    numbers = np.arange(count)
    phase = numbers / 1000 % TOUCH_EVERY_S
    touches = phase >= TOUCH_EVERY_S - TOUCH_S
    depth = np.where(touches, np.sin(np.pi * (phase - TOUCH_EVERY_S + TOUCH_S) / TOUCH_S), 0)

    def cycles(late, dead_man, acts):
        """Cycles of an end that is `late` behind the robot's contact."""
        rows = np.zeros(count, SAMPLE)
        rows["time_ns"] = BEGIN_NS + numbers * MS + 13 * late
        rows["x_m"] = 0.02 * np.sin(2 * np.pi * np.roll(phase, late))
        rows["y_m"] = 0.01 * np.cos(2 * np.pi * np.roll(phase, late))
        rows["fx_n"] = -3 * np.roll(depth, late)
        rows["fy_n"] = 0.25 * np.roll(depth, late)
        rows["energy_uj"] = 100 + numbers % 50
        rows["flags"] = [
            flags_of(contact=bool(contact), dead_man=dead_man, acted=acts, state=2, lit=None)
            for contact in (touches if not late else np.zeros(count, bool))
        ]
        return rows

    robot, joystick = cycles(0, True, False), cycles(LINK_CYCLES, True, True)
    sent, acted_on = numbers & 0xFFFF, numbers - LINK_CYCLES
    haptics = {}
    for key, sender, receiver in (("up", robot, joystick), ("down", joystick, robot)):
        for way, rows, sequence in (("sent", sender, sent), ("received", receiver, acted_on)):
            rows = rows.copy()
            rows["sequence"] = np.where(sequence < 0, NO_SAMPLE, sequence & 0xFFFF)
            haptics[f"/haptic/{key}/{way}"] = rows
    edges = np.flatnonzero(np.diff(np.concatenate(([0], touches, [0]))))
    contacts = [
        (int(robot["time_ns"][first]), int(robot["time_ns"][behind - 1]))
        for first, behind in edges.reshape(-1, 2)
    ]
    return haptics, contacts


def haptic_messages(haptics):
    """Twenty cycles a message; its instant is that of the first."""
    for topic, rows in haptics.items():
        for number, first in enumerate(range(0, len(rows), 20)):
            block = rows[first : first + 20]
            yield told(topic, int(block["time_ns"][0]), number, pack_haptics(block), 20 * MS)


def command_messages(seconds, contacts):
    """A switch of the camera in the middle, housekeeping, events with their lines, losses."""
    middle_ns = BEGIN_NS + round(seconds * S / 2) + 123_457
    select = pack_packet(
        Telecommand(apid=0x133, count=7, service=8, subtype=1, data=b"\1static\0\0\0\0\0")
    )
    done = bytes.fromhex("1933c007")
    answer = pack_packet(Telemetry(apid=0x133, count=1, service=1, subtype=7, data=done))
    yield packet("/telecommand/space/sent", middle_ns, 0, select)
    yield packet("/telecommand/ground/received", middle_ns + LINK_NS, 0, select)
    yield packet("/telemetry/ground/sent", middle_ns + LINK_NS + 2 * MS, 0, answer)
    yield packet("/telemetry/space/received", middle_ns + 2 * LINK_NS, 0, answer)
    for number, at_ns in enumerate(range(BEGIN_NS, BEGIN_NS + int(seconds * S), S // 2), 1):
        camera = b"\1stereo\0\0\0\0\0"
        state = pack_packet(Telemetry(apid=0x133, count=number, service=3, subtype=25, data=camera))
        yield packet("/telemetry/ground/sent", at_ns, number, state)
        yield packet("/telemetry/space/received", at_ns + LINK_NS, number, state)
    happened = [(BEGIN_NS, "link", "the link is up"), (middle_ns, "camera", "static is selected")]
    happened += [(first_ns, "touch", "the robot touches the board") for first_ns, _ in contacts]
    for number, (at_ns, what, text) in enumerate(sorted(happened), start=1):
        event = RecordedEvent(session_ns=at_ns, number=number, what=what, text=text)
        line = LogLine(wall_ns=wall_ns(at_ns), level=LogLevel.INFO, message=text, name=what)
        yield told("/events", at_ns, number, pack(event))
        yield told("/log", at_ns, number, pack(line))
    at_ns = BEGIN_NS + round(seconds * S) - MS
    losses = (ChannelLoss(channel="/camera/head", missed=2, dropped=1),)
    yield told("/recorder/losses", at_ns, 0, pack(RecorderLosses(session_ns=at_ns, losses=losses)))
    metrics = (RecordedFigure(name="uplink_video.state", number=0.0, text="fresh"),)
    yield told("/figures", at_ns, 1, pack(RecordedMetrics(session_ns=at_ns, metrics=metrics)))


def packet(topic, at_ns, sequence, data):
    value = RecordedPacket(session_ns=at_ns, data=data, what=WORDS.of(data))
    return told(topic, at_ns, sequence, pack(value))


def link_messages(seconds, link_frames):
    """Ten times a second, what each end of each direction counts."""
    for number in range(int(seconds * 10)):
        at_ns, some = BEGIN_NS + number * 100 * MS, number % 3
        state = {"session_ns": at_ns, "signal": True, "state": "CONNECTED"}
        queue = {"packets": some, "octets": 200 * some, "oldest_age_ns": MS * some}
        sent = {"frames": 100 * number, "haptic_sent": 100 * number, "haptic_superseded": 0}
        came = {"frames": 99 * number, "frames_lost": number, "frames_dropped": 0}
        came |= {"haptic_received": 99 * number, "packets": 5 * number, "packets_dropped": 0}
        octets = {"haptic": 1200 * number, "video": 1000 * number}
        told_sent = LinkSent(
            **sent,
            carried=tuple(CarriedOctets(what=what, octets=each) for what, each in octets.items()),
            queues=(QueueState(level="VIDEO", accepted=5 * number, dropped=0, **queue),),
            delay_ns=10 * MS,
            radio_frames_lost=number // 10,
            capacity_bps=0,
            **state,
        )
        frames = RecordedFrames(time_ns=[at_ns, at_ns + MS], data=[b"\x01" * 32] * 2)
        for direction, capacity_bps in (("uplink", 256_000), ("downlink", 4_000_000)):
            row = replace(told_sent, capacity_bps=capacity_bps)
            yield told(f"/link/{direction}/sent", at_ns, number, pack(row))
            received = pack(LinkReceived(**came, **state))
            yield told(f"/link/{direction}/received", at_ns, number, received)
            for way in ("sent", "received") if link_frames else ():
                yield told(f"/link/{direction}/frames/{way}", at_ns, number, pack(frames))
