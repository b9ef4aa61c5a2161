"""Receiver estimated maximum bitrate (REMB, draft-alvestrand-rmcat-remb-03), both ends."""

import struct

from kontur_av.rtp.wire import RTCP_PSFB_APP, RtcpPsfbPacket, pack_remb_fci, unpack_remb_fci


def rate_message(rate_bps: int, *, ssrc: int, media_ssrcs: list[int]) -> bytes:
    """Return a REMB. ssrc: the receiver's own. media_ssrcs: the streams that share the rate."""
    fci = pack_remb_fci(rate_bps, media_ssrcs)
    return bytes(RtcpPsfbPacket(RTCP_PSFB_APP, ssrc, 0, fci))


def told_rate(packet: RtcpPsfbPacket) -> tuple[int, list[int]] | None:
    """Return the rate in bit/s and the streams that share it; None if `packet` is no REMB."""
    if packet.fmt != RTCP_PSFB_APP:
        return None
    try:
        rate_bps, ssrcs = unpack_remb_fci(packet.fci)
    except (ValueError, IndexError, struct.error):
        return None
    return rate_bps, ssrcs
