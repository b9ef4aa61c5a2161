"""The bridge to Foxglove on virtual time: who is told what, where decoders begin, what is lost."""

import json
import re
import struct
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from positions import ROOT

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Decoder, H264Encoder, H265Encoder
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.foxglove.bridge import Bridge, live_channels
from pipelines.foxglove.client import MOST_AGE_NS
from pipelines.media.key_picture_maker import key_of
from pipelines.mission.tmtc_messages import CommandUpdate
from pipelines.recording.channels import sources_of
from pipelines.recording.recorded_messages import (
    RecordedPacket,
    RecordedPicture,
    UnitMetadata,
    unpack,
)
from pipelines.recording.session_messages import Instants
from pipelines.session.session_metrics import Event, SessionNews
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet
from telepresence.tmtc.pus.verification import (
    Verification,
    VerificationStage,
    pack_verification,
)

TOPOLOGY = topology_of(BUILT_IN["spacejustin"])
SOURCES = {source.topic: source for source in sources_of(TOPOLOGY)}
CHANNELS = {row.topic: row.number for row in live_channels(TOPOLOGY)}
VIDEO, SENT = "/uplink_video/sent", "sent/uplink_video"
HEAD = struct.Struct("<BIQ")


def new_bridge():
    return Bridge(TOPOLOGY, built_in_dictionary(), "test", wall_offset_ns=NS_PER_S, boot_id=1)


@pytest.fixture
def bridge():
    return new_bridge()


def joined(bridge, *topics, now_ns=0, commands=True):
    """A client that has subscribed these channels, each by its channel's number."""
    number = bridge.handle_opened(commands=commands)
    subscriptions = [{"id": CHANNELS[topic], "channelId": CHANNELS[topic]} for topic in topics]
    text = json.dumps({"op": "subscribe", "subscriptions": subscriptions})
    bridge.handle_text(number, text, now_ns)
    taken(bridge, number)
    return number


def taken(bridge, number):
    """Texts as tables, and messages of channels as (topic, log time, data)."""
    topics = {channel: topic for topic, channel in CHANNELS.items()}
    found = []
    for message in iter(lambda: bridge.poll_transmit(number), None):
        if isinstance(message, str):
            found.append(json.loads(message))
        else:
            _, subscription, log_ns = HEAD.unpack_from(message)
            found.append((topics[subscription], log_ns, message[HEAD.size :]))
    return found


def units(count):
    """A stream as it is sent: a key picture once, then refresh waves; and its added keys."""
    encoder = H264Encoder(width=160, height=120, fps=Fraction(30), cap_bps=200_000)
    sets = b""
    for number in range(count):
        picture = empty_picture(160, 120)
        picture[:120] = (np.arange(160) * 2 + np.arange(120)[:, None] + 3 * number) % 200 + 20
        picture[120:] = 128
        stamp = CaptureStamp(number * NS_PER_S // 30, number, "test")
        unit = encoder.encode(VideoFrame(picture, stamp))
        sets = sets or H264.parameter_sets(unit.data)
        width, height = encoder.unit_size
        size = {"width": width, "height": height}
        coded = CodedUnit(data=unit.data, key=unit.keyframe, parameter_sets=sets, **size)
        key = key_of(picture, width, height)
        yield coded, stamp, replace(coded, data=key, key=True, added=True)


def show(bridge, unit, stamp, key=None):
    now_ns = stamp.capture_ns + NS_PER_MS
    asks = bridge.poll_ask(SOURCES[SENT], now_ns)
    for sample in (unit, key) if asks and key is not None else (unit,):
        bridge.handle_sample(SOURCES[SENT], sample.pack(), stamp, Instants(now_ns, now_ns))
    bridge.handle_time(now_ns)


def hevc(data, **fields):
    return CodedUnit(data=data, codec="h265", width=160, height=128, **fields)


def pictures(messages):
    decoder, shown = H264Decoder(), 0
    for _, _, data in messages:
        shown += len(decoder.decode(unpack(RecordedPicture, data).data, 0))
    return shown


def test_who_joins_late_begins_with_a_key_picture_of_which_others_hear_nothing(bridge):
    first, late = joined(bridge, VIDEO), None
    of_first, of_late = [], []
    for unit, stamp, key in units(40):
        if stamp.sequence == 20:
            late = joined(bridge, VIDEO, f"{VIDEO}/facts", now_ns=stamp.capture_ns)
        show(bridge, unit, stamp, key)
        of_first += taken(bridge, first)
        of_late += [] if late is None else taken(bridge, late)
    assert len(of_first) == pictures(of_first) == 40
    metadata = [unpack(UnitMetadata, data) for topic, _, data in of_late if topic.endswith("facts")]
    of_late = [one for one in of_late if one[0] == VIDEO]
    # The key picture of the unit 20, in its place.
    assert len(of_late) == pictures(of_late) == 20
    assert sorted(one.added for one in metadata) == [False] * 20 + [True]
    assert of_late[2:] == of_first[22:]


def test_after_missed_units_clients_begin_anew(bridge):
    client, shown = joined(bridge, VIDEO), []
    for unit, stamp, key in units(30):
        if not 10 <= stamp.sequence < 13:
            show(bridge, unit, stamp, key)
            shown.append(len(taken(bridge, client)))
    # The first one behind the gap waits for the next, at which a key picture is asked for.
    assert shown == [1] * 10 + [0] + [1] * 16


def test_after_a_refused_unit_of_hevc_clients_begin_again_with_the_next_key_picture(bridge):
    reader = joined(bridge, VIDEO)
    coder = H265Encoder(width=160, height=128, fps=30, cap_bps=200_000, refresh_s=60)
    picture = empty_picture(160, 128)
    picture[:] = 128
    decoder, shown = VideoDecoder("h265"), 0
    for number in range(30):
        stamp = CaptureStamp(number * NS_PER_S // 30, number, "test")
        unit = coder.encode(VideoFrame(picture, stamp), Coding(keyframe=number == 20))
        refused = number in (10, 11)
        show(bridge, hevc(unit.data, key=unit.keyframe, refused=refused), stamp)
        for _, _, data in taken(bridge, reader):
            shown += len(decoder.decode(unpack(RecordedPicture, data).data, number))
    assert shown == 20
    assert decoder.counts.frames_corrupt == 0
    assert bridge.metrics(NS_PER_S).undecodable == 10


def test_who_reads_nothing_loses_the_oldest_and_begins_anew(bridge):
    slow, fast = joined(bridge, VIDEO), joined(bridge, VIDEO)
    of_fast, of_slow = [], []
    for unit, stamp, key in units(150):
        show(bridge, unit, stamp, key)
        of_fast += taken(bridge, fast)
        # After its pause of three seconds it keeps up.
        if stamp.capture_ns > MOST_AGE_NS + NS_PER_S:
            of_slow += taken(bridge, slow)
    assert len(of_fast) == pictures(of_fast) == 150
    metrics = bridge.metrics(5 * NS_PER_S).channels[VIDEO]
    messages = [one for one in of_slow if isinstance(one, tuple)]
    (told,) = [one for one in of_slow if isinstance(one, dict)]
    assert "too slow" in told["message"] and VIDEO in told["message"]
    assert len(messages) == pictures(messages) > 30
    assert metrics.kept == len(of_fast) + len(messages)
    # One more, which is the key picture.
    assert metrics.kept + metrics.dropped == 2 * 150 + 1 and metrics.dropped > 55


def test_metrics_and_events_come_whole_to_who_joins_late(bridge):
    event = Event(number=1, at_us=3, what="link", text="signal")
    bridge.handle_session(SessionNews(at_us=5, events=[event], figures={"a": 1, "b": "x"}), 0)
    number = joined(bridge)
    bridge.handle_text(number, '{"op":"subscribeParameterUpdates","parameterNames":[]}', 0)
    bridge.handle_session(SessionNews(at_us=6, events=[], figures={"a": 2, "b": "x"}), 0)
    changed = [{"name": "figures.a", "value": 2}]
    assert taken(bridge, number) == [{"op": "parameterValues", "parameters": changed}]
    bridge.handle_text(number, '{"op":"getParameters","parameterNames":["setup.name"],"id":"q"}', 0)
    named = [{"name": "setup.name", "value": "spacejustin"}]
    assert taken(bridge, number) == [{"op": "parameterValues", "id": "q", "parameters": named}]
    subscriptions = [{"id": 1, "channelId": CHANNELS["/log"]}]
    bridge.handle_text(number, json.dumps({"op": "subscribe", "subscriptions": subscriptions}), 0)
    assert len(taken(bridge, number)) == 1


def call(service, text, number=9):
    return struct.pack("<BIII", 2, service, number, 4) + b"json" + text.encode()


def test_a_report_names_a_telecommand_whose_channel_nobody_reads(bridge):
    client = joined(bridge, "/telemetry/ground/sent")
    command = Telecommand(apid=0x120, count=5, service=8, subtype=1, data=b"\3")
    done = pack_verification(Verification(0x120, 5, VerificationStage.COMPLETED))
    report = Telemetry(apid=0x120, count=9, service=1, subtype=7, data=done)
    assert {"tc/ground/received", "tm/ground/sent"} <= {one.topic for one in bridge.wanted}
    for topic, packet in (("tc/ground/received", command), ("tm/ground/sent", report)):
        stamp = CaptureStamp(NS_PER_S, 0, topic)
        octets = pack_packet(packet)
        bridge.handle_sample(SOURCES[topic], octets, stamp, Instants(NS_PER_S, NS_PER_S))
    ((_, _, data),) = taken(bridge, client)
    assert unpack(RecordedPacket, data).what == "PUS 1,7 joystick: stop: completed"


def test_a_service_is_a_telecommand_that_who_only_watches_may_not_send(bridge):
    watcher, number = joined(bridge, commands=False), joined(bridge)
    bridge.handle_octets(watcher, call(1, '{"camera": "head"}'), 0)
    assert taken(bridge, watcher)[0]["op"] == "serviceCallFailure"
    assert bridge.services.poll_transmit(0) is None
    for wrong in ('{"camera": 1}', "{}", "x", '{"camera": "head", "more": "x"}'):
        bridge.handle_octets(number, call(1, wrong), 0)
        assert taken(bridge, number)[0]["op"] == "serviceCallFailure"
    bridge.handle_octets(number, call(1, '{"camera": "head"}'), 0)
    segment, command = bridge.services.poll_transmit(0)
    assert (segment, command.application, command.name) == (Segment.SPACE, "camera", "select")
    assert command.arguments == ("head",)
    ended = {"done": True, "ok": True, "verified": True}
    update = CommandUpdate(command.client, command.id, "camera", "completed", **ended)
    bridge.services.handle_update(segment, update)
    bridge.handle_time(0)
    answer = bridge.poll_transmit(number)
    assert struct.unpack_from("<BII", answer) == (3, 1, 9)

    # Who asks without reading is closed.
    with pytest.raises(ProtocolError):
        for _ in range(100):
            bridge.handle_text(number, '{"op":"setParameters","parameters":[]}', 0)


@given(st.one_of(st.text(), st.binary(), st.from_regex(r'\{"op":"\w{1,30}"(,"\w+":\[?\w*)*')))
def test_garbage_is_refused(garbage):
    bridge = new_bridge()
    number = joined(bridge)
    with pytest.raises(ProtocolError):
        if isinstance(garbage, bytes):
            bridge.handle_octets(number, b"\x01" + garbage, 0)
        else:
            bridge.handle_text(number, garbage, 0)


def test_the_layout_names_channels_and_services_that_there_are():
    layout = (ROOT / "samples" / "foxglove" / "layout.json").read_text()
    json.loads(layout)
    named = set(re.findall(r'"(/[a-z_/]+)', layout))
    services = {row.name for row in new_bridge().services.rows}
    assert len(named) > 6 and named <= CHANNELS.keys() | services
