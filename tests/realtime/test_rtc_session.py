"""A session with a partner: who it sees and hears, what is kept of it, and that no trouble of its
leg reaches the radio link."""

import asyncio
import socket

import pytest
from partners import kept, pictures, receiving, send, sending, sounds, until
from running_session import assert_sound

from benchmarks.page.footage import coded
from kontur_av.codecs.h264 import H264Decoder
from kontur_av.rtp.rate_feedback import rate_message
from kontur_av.rtp.wire import RTCP_PSFB_PLI, RtcpPsfbPacket
from pipelines.bench.course.marks import levels, read_number

pytestmark = pytest.mark.realtime

TOKEN = "word-of-the-partner"
#: The streams of SpaceJustin with small pictures: three partners run in this process, too.
SMALL = """
cameras = ["head"]
uplink_video = {cap_kbps = 85, size = "320x240", fps = 15}
uplink_voice = {cap_kbps = 8}
downlink_video = {cap_kbps = 512, size = "320x240", fps = 15}
downlink_voice = {cap_kbps = 64}
"""


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as bound:
        return bound.getsockname()[1]


def number_of(lease):
    """The number that the footage's picture shows."""
    frame = lease.video()
    return read_number(levels(frame.data[: frame.height]))


def test_a_partner_takes_part_and_no_trouble_of_its_leg_reaches_the_link(
    start, tmp_path, monkeypatch
):
    token, port = tmp_path / "token", free_port()
    token.write_text(TOKEN)
    setup = tmp_path / "small.toml"
    setup.write_text(SMALL)
    units, uplink, downlink, numbers, heard = coded(150), [], [], set(), []
    recording = str(tmp_path / "rtc.mcap")
    session = start(
        str(setup),
        *("--rtc", str(port), "--rtc-token-file", str(token), "--record", recording),
    )
    session.wait_for_flow()
    base = f"http://127.0.0.1:{port}"

    def look(camera, voice):
        while (lease := camera.next()) is not None:
            with lease:
                numbers.add(number_of(lease))
        while (lease := voice.next()) is not None:
            with lease:
                heard.append(lease.stamp)

    async def takes_part(bus):
        camera, voice = (
            bus.reader("received/rtc_camera", depth=8),
            bus.reader("received/rtc_voice", depth=8),
        )
        async with (
            kept(f"{base}/whip", sending, TOKEN) as sender,
            kept(f"{base}/whep/uplink", receiving(uplink), TOKEN),
            kept(f"{base}/whep/downlink", receiving(downlink), TOKEN),
        ):
            sent = asyncio.create_task(send(units, sender.peer.send_unit, sender.peer.send_opus))
            while not sent.done():
                look(camera, voice)
                await asyncio.sleep(0.02)
            await until(lambda: len(pictures(uplink)) > 40 and len(pictures(downlink)) > 40)

    async def makes_trouble():
        """Ask for key pictures and a low rate without end, then vanish without a word."""
        async with kept(f"{base}/whep/downlink", receiving([]), TOKEN) as viewer:
            peer = viewer.peer
            source = peer.media.picture.line.peer_ssrc
            await until(lambda: peer.media.picture.source is not None)
            for _ in range(200):
                await peer._transport.send(bytes(RtcpPsfbPacket(RTCP_PSFB_PLI, 1, source)))
                await peer._transport.send(rate_message(1, ssrc=1, media_ssrcs=[source]))
                await peer._transport.send(b"\x80\xc9garbage")
                await asyncio.sleep(0.005)
            await peer._transport._connection.close()

    with session.bus(monkeypatch) as bus:
        asyncio.run(takes_part(bus))
    asyncio.run(makes_trouble())
    session.wait_for_flow()
    code, report = session.interrupt()
    assert code == 0
    assert_sound(report)

    # The partner saw and heard both sides; the passed-on picture begins with one coded here.
    for events in (uplink, downlink):
        decoder = H264Decoder()
        whole = [
            picture
            for unit in pictures(events)
            for picture in decoder.decode(unit.data, unit.timestamp)
        ]
        assert len(whole) > 30
        assert len(sounds(events)) > 40
        assert pictures(events)[0].keyframe
    # It was seen in the right order of magnitude, and heard.
    assert len(numbers - {None}) > 20
    assert len(heard) > 40
    rtc = report["rtc"]
    assert rtc["connections"] == 4
    assert rtc["route"] == "host to host"
    assert {name for name, one in rtc["streams"].items() if one["packets"] > 40} == {
        *("rtc_video", "rtc_speech", "downlink_video", "downlink_voice"),
        *("rtc_camera", "rtc_voice"),
    }
    channels = report["recorder"]["channels"]
    for name in ("rtc_camera/received", "rtc_voice/received", "rtc_video/sent"):
        assert channels[f"/{name}"]["kept"] > 20, name
    # Nothing of it reached the link: nothing lost, and no key picture asked of the ISS's encoder.
    for name, stream in report["streams"].items():
        assert stream["rtp_lost"] == 0, name
    assert rtc["streams"]["downlink_video"]["keys_asked"] > 50
    for name in ("downlink_video_send", "uplink_video_send"):
        assert report["processes"][name]["counts"]["feedback_received"] == 0
    assert all(process["restarts"] == 0 for process in report["processes"].values())
