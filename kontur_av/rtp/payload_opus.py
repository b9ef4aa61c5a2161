"""Opus in RTP (RFC 7587): each payload is one Opus packet, whose first octet tells its length."""

from typing import TYPE_CHECKING

from kontur_av.errors import ProtocolError
from kontur_av.media import MAX_OPUS_SAMPLES

if TYPE_CHECKING:
    from kontur_av.rtp.receiver import RtpReceived

#: Packets in a row that show by how much a clock is too slow.
_SHOWN_BY = 3


def opus_samples(payload: bytes) -> int:
    """Return the samples per channel at 48 kHz of an Opus packet (RFC 6716 section 3.1).

    Raises ProtocolError if the payload is no Opus packet.
    """
    if not payload:
        raise ProtocolError("an empty Opus packet")
    config, code = payload[0] >> 3, payload[0] & 3
    if config < 12:  # SILK
        frame = (480, 960, 1920, 2880)[config & 3]
    elif config < 16:  # hybrid
        frame = (480, 960)[config & 1]
    else:  # CELT
        frame = (120, 240, 480, 960)[config & 3]
    if code == 3:
        if len(payload) < 2:
            raise ProtocolError("an Opus packet of code 3 without its frame count")
        count = payload[1] & 0x3F
    else:
        count = 1 if code == 0 else 2
    samples = frame * count
    if not 0 < samples <= MAX_OPUS_SAMPLES:
        raise ProtocolError(f"an Opus packet of {samples} samples; 120 ms is the most")
    return samples


class SlowClock:
    """Finds a sender whose timestamps advance too slowly.

    They must count 48 kHz (RFC 7587 section 4.1), but some count their own samples, or the samples
    of one of two channels. Then packets would overlap, which none does otherwise.
    """

    def __init__(self) -> None:
        self._last: tuple[int, int, int] | None = None
        self._scale, self._shown = 1, 0

    def handle_packet(self, packet: "RtpReceived") -> int:
        """Return by which factor the timestamps must be multiplied anew from this packet on."""
        try:
            samples = opus_samples(packet.payload)
        except ProtocolError:
            return 1
        last, self._last = self._last, (packet.extended_sequence, packet.timestamp, samples)
        if last is None or packet.restart or packet.extended_sequence != last[0] + 1:
            self._shown = 0
            return 1
        step = (packet.timestamp - last[1]) & 0xFFFF_FFFF
        scale = last[2] // step if 0 < step < last[2] and last[2] % step == 0 else 1
        self._shown = self._shown + 1 if scale == self._scale else 1
        self._scale = scale
        if scale == 1 or self._shown < _SHOWN_BY:
            return 1
        self._last = None
        return scale


def holds_copy(payload: bytes) -> bool:
    """Return whether an Opus packet of one frame carries a coarse copy of the packet before it.

    The LBRR flag tells it. It follows one voice activity flag for each 20 ms (RFC 6716 sections
    4.2.3 and 4.2.4). Only SILK and hybrid frames have it. False for packets of several frames.
    """
    flags = _silk_flags(payload)
    return flags is not None and bool(flags[0] & 0x80 >> flags[1])


def is_pause(payload: bytes) -> bool:
    """Return whether an Opus packet of one frame is a pause in speech.

    Then no voice activity flag is set (RFC 6716 section 4.2.3). False for packets without these
    flags, such as CELT frames.
    """
    flags = _silk_flags(payload)
    return flags is not None and not flags[0] >> 8 - flags[1]


def _silk_flags(payload: bytes) -> tuple[int, int] | None:
    """Return the octet with the flags of a SILK or hybrid frame, and its number of blocks."""
    begin = _only_frame(payload)
    config = payload[0] >> 3 if payload else 16
    if begin is None or begin >= len(payload) or config >= 16:
        return None
    return payload[begin], (1, 1, 2, 3)[config & 3] if config < 12 else 1


def _only_frame(payload: bytes) -> int | None:
    """Return where the frame of a packet of one frame begins (RFC 6716 section 3.2).

    None for packets of several frames.
    """
    if len(payload) < 2:
        return None
    if payload[0] & 3 == 0:
        return 1
    # Constant bit rate: one frame and padding.
    if payload[0] & 3 != 3 or payload[1] & 0x3F != 1:
        return None
    at = 2
    if payload[1] & 0x40:
        while at < len(payload) and payload[at] == 0xFF:
            at += 1
        at += 1
    return at
