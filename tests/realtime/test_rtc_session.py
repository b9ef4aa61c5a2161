"""A session with a partner: who it sees and hears, what is kept of it, and that no trouble of its
leg reaches the radio link."""

import asyncio

from partners import kept, pictures, receiving, send, sending, sounds, until
from running_session import SMALL, assert_nothing_lost_in_contact, restarted, tcp_port

from benchmarks.page.footage import coded
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.rtp.feedback import rate_message
from kontur_av.rtp.rtcp import RTCP_PSFB_PLI, RtcpPsfbPacket

TOKEN = "word-of-the-partner"


def test_no_trouble_of_a_partners_leg_reaches_the_link(start, tmp_path):
    token, port = tmp_path / "token", tcp_port()
    token.write_text(TOKEN)
    units, uplink = coded(50), []
    session = start(
        SMALL.replace('"static", ', ""),
        *("--rtc", str(port), "--rtc-token-file", str(token), "--record", "rtc.mcap"),
    )
    session.wait_for_flow()
    base = f"http://127.0.0.1:{port}"

    async def takes_part():
        async with (
            kept(f"{base}/whip", sending, TOKEN) as sender,
            kept(f"{base}/whep/uplink", receiving(uplink), TOKEN),
        ):
            await send(units, sender.peer.send_unit, sender.peer.send_opus)
            await until(lambda: len(pictures(uplink)) > 20 and len(sounds(uplink)) > 20)

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

    asyncio.run(takes_part())
    asyncio.run(makes_trouble())
    session.wait_for_flow()
    report = session.finish(sound=True)
    # The passed-on picture begins with one coded here.
    assert pictures(uplink)[0].keyframe
    decoder = H264Decoder()
    whole = [one for unit in pictures(uplink) for one in decoder.decode(unit.data, unit.timestamp)]
    assert len(whole) > 15
    rtc, channels = report["rtc"], report["recorder"]["channels"]
    assert rtc["connections"] >= 3 and rtc["route"] == "host to host"
    for name in ("rtc_camera/received", "rtc_voice/received", "rtc_video/sent"):
        assert channels[f"/{name}"]["kept"] > 10, name
    # Nothing is lost, and no key picture was asked of the ISS's encoder.
    assert rtc["streams"]["downlink_video"]["keys_asked"] > 0
    contacts_lost = assert_nothing_lost_in_contact(report)
    for name in ("downlink_video_send", "uplink_video_send"):
        asked = report["processes"][name]["counts"]["feedback_received"]
        assert contacts_lost or asked == 0, name
    assert restarted(report) == {}
