"""Messages of a recording octet by octet, computed by hand from protobuf's wire format.

A field is its number * 8 + 0 (varint), 1 (8 octets), 2 (length, then octets) or 5 (4 octets), then
its value. Numbers that repeat are packed: one field of octets. A field that is 0 or empty is left
out (https://protobuf.dev/programming-guides/encoding).
"""

import numpy as np
import pytest

from kontur_av.errors import ProtocolError
from pipelines.recording.export.columns import Columnizer
from pipelines.recording.joined import JoinedMessage
from pipelines.recording.recorded_messages import (
    SAMPLE,
    SCHEMAS,
    CarriedOctets,
    ChannelLoss,
    LinkReceived,
    LinkSent,
    LogLevel,
    LogLine,
    ParameterValue,
    QueueState,
    RecordedDriver,
    RecordedEvent,
    RecordedExperiment,
    RecordedFigure,
    RecordedFrames,
    RecordedLeds,
    RecordedMetrics,
    RecordedPacket,
    RecordedPanel,
    RecordedParameters,
    RecordedPicture,
    RecordedSound,
    RecorderLosses,
    UnitMetadata,
    pack,
    pack_haptics,
    unpack,
    unpack_haptics,
)

VECTORS = [
    (
        # 1: message of (1: 1 s, 2: 2 ns) | 2: "stereo" | 3: octets | 4: "h264"
        "0a04 0801 1002 | 1206 73746572656f | 1a05 0000000165 | 2204 68323634",
        RecordedPicture(wall_ns=1_000_000_002, frame_id="stereo", data=b"\0\0\0\x01\x65"),
    ),
    (
        "0a02 0801 | 1202 f8ff | 1a04 6f707573",
        RecordedSound(wall_ns=1_000_000_000, data=b"\xf8\xff"),
    ),
    (
        # 2: WARNING = 3 | 3: "lost" | 4: "link"
        "0a02 0801 | 1003 | 1a04 6c6f7374 | 2204 6c696e6b",
        LogLine(wall_ns=1_000_000_000, level=LogLevel.WARNING, message="lost", name="link"),
    ),
    (
        # 1: 300 = 0x2c + 2 * 128 | 7: 640 = 5 * 128 | 8: 480 = 0x60 + 3 * 128 | 9: 1000
        "08ac02 | 1001 | 2001 | 3001 | 388005 | 40e003 | 48e807",
        UnitMetadata(
            capture_ns=300,
            key=True,
            damaged=False,
            shows_loss=True,
            refused=False,
            dated=True,
            width_px=640,
            height_px=480,
            octets=1000,
        ),
    ),
    (
        # 1: -1 as 64 bits, 7 at a time | 2: octets | 3: "no"
        "08ffffffffffffffffff01 | 1202 1801 | 1a02 6e6f",
        RecordedPacket(session_ns=-1, data=b"\x18\x01", what="no"),
    ),
    (
        # 2: "idle" | 3: "line" | 4: 2 | 5: "hold" | 6: 1 | 7: "aborted" | 8: "no"
        "0801 | 1204 69646c65 | 1a04 6c696e65 | 2002 | 2a04 686f6c64 | 3001"
        "| 3a07 61626f72746564 | 4202 6e6f",
        RecordedExperiment(
            session_ns=1,
            phase="idle",
            task="line",
            run=2,
            elemop="hold",
            ended_run=1,
            result="aborted",
            reason="no",
        ),
    ),
    (
        # 2: "hold" | 3: "line" | 4: 2 | 5: "no" | 6: "reach" | 7: 1 | 8: 4 | 9: True
        "0801 | 1204 686f6c64 | 1a04 6c696e65 | 2002 | 2a02 6e6f | 3205 7265616368 | 3801 | 4004"
        "| 4801",
        RecordedPanel(
            session_ns=1,
            mode="hold",
            task="line",
            run=2,
            words="no",
            goal="reach",
            step=1,
            steps=4,
            dead_man=True,
        ),
    ),
    (
        # 2: "spot" | 3: 5 | 4: 0.5, 5: -2.0 in 8 octets each
        "0801 | 1204 73706f74 | 1805 | 21 000000000000e03f | 29 00000000000000c0",
        RecordedLeds(session_ns=1, pattern="spot", leds=5, spot_x_m=0.5, spot_y_m=-2.0),
    ),
    (
        # 2: "p" | 3: "p" | 4: true | 5: "x" | 6: 0.5
        "0801 | 120170 | 1a0170 | 2001 | 2a0178 | 3208 000000000000e03f",
        RecordedDriver(session_ns=1, who="p", policy="p", drives=True, axes=("x",), wanted=(0.5,)),
    ),
    (
        # 1: two numbers of 8 octets | 2: one octet | 2: none
        "0a10 0100000000000000 0200000000000000 | 1201 aa | 1200",
        RecordedFrames(time_ns=(1, 2), data=(b"\xaa", b"")),
    ),
    (
        # 2: 64000 = 0 + 0x74 * 128 + 3 * 16384 | 6: ("video", 200) | 7: ("voice", 2, 100, 7, 9, 1)
        "0801 | 1080f403 | 1805 | 2004 | 2801 | 320a 0a05766964656f 10c801"
        "| 3a11 0a05766f696365 1002 1864 2007 2809 3001 | 4003 | 4802 | 5001 | 5a02 7570",
        LinkSent(
            session_ns=1,
            capacity_bps=64_000,
            frames=5,
            haptic_sent=4,
            haptic_superseded=1,
            carried=(CarriedOctets(what="video", octets=200),),
            queues=(
                QueueState(
                    level="voice", packets=2, octets=100, oldest_age_ns=7, accepted=9, dropped=1
                ),
            ),
            delay_ns=3,
            radio_frames_lost=2,
            signal=True,
            state="up",
        ),
    ),
    (
        "0801 | 1005 | 1801 | 2002 | 2804 | 3006 | 3801 | 4001 | 4a02 7570",
        LinkReceived(
            session_ns=1,
            frames=5,
            frames_lost=1,
            frames_dropped=2,
            haptic_received=4,
            packets=6,
            packets_dropped=1,
            signal=True,
            state="up",
        ),
    ),
    (
        "0801 | 1002 | 1a04 6c696e6b | 2203 4c4f53",
        RecordedEvent(session_ns=1, number=2, what="link", text="LOS"),
    ),
    (
        "0801 | 1208 0a022f61 1003 1804",
        RecorderLosses(session_ns=1, losses=(ChannelLoss(channel="/a", missed=3, dropped=4),)),
    ),
    (
        "0801 | 120c 0a0161 11000000000000f83f",
        RecordedMetrics(session_ns=1, metrics=(RecordedFigure(name="a", number=1.5, text=""),)),
    ),
    (
        "0801 | 120f 0a0161 120156 19000000000000f83f",
        RecordedParameters(
            session_ns=1, values=(ParameterValue(name="a", unit="V", number=1.5, text=""),)
        ),
    ),
]
# Packed: 1 in 8 octets | -1 | 1.0 | -2.0 | 0.5 | 0.0 | 8.0 | state 3, LED 1 lit, contact
SAMPLES = bytes.fromhex(
    "0a08 0100000000000000 1204 ffffffff 1a04 0000803f 2204 000000c0"
    "2a04 0000003f 3204 00000000 3a04 00000041 4204 01030200"
)
ONE_SAMPLE = np.array([(1, -1, 1.0, -2.0, 0.5, 0.0, 8.0, 0x00020301)], SAMPLE)


@pytest.mark.parametrize(
    ("text", "value"), VECTORS, ids=[value.schema.name for _, value in VECTORS]
)
def test_golden(text, value):
    octets = bytes.fromhex(text.replace("|", ""))
    assert pack(value) == octets
    assert unpack(type(value), octets) == value
    # Whatever repeats in it, it is a row of a table.
    message = JoinedMessage("/topic", value.schema.full_name, 0, 0, 0, octets, 0)
    rows = Columnizer(0).rows(message)
    assert {len(column) for column in rows.values()} == {len(rows["time_s"])}


def test_golden_haptic_samples():
    assert pack_haptics(ONE_SAMPLE) == SAMPLES
    assert unpack_haptics(SAMPLES).tolist() == ONE_SAMPLE.tolist()
    # A flag is missing.
    with pytest.raises(ProtocolError, match=r"fields of \[0, 1\] values"):
        unpack_haptics(SAMPLES[:-6])


def test_every_schema_has_its_vector():
    golden = {value.schema.full_name for _, value in VECTORS} | {"kontur_av.HapticSamples"}
    assert {schema.full_name for schema in SCHEMAS} == golden
