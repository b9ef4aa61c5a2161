"""Opus in RTP (RFC 7587): one Opus packet is one payload; its first octet says how long it is."""

from kontur_av.errors import ProtocolError
from kontur_av.media import MAX_OPUS_SAMPLES


def opus_samples(payload: bytes) -> int:
    """The number of samples per channel at 48 kHz in an Opus packet (RFC 6716 section 3.1).

    Raises ProtocolError if the payload cannot be an Opus packet.
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


def holds_copy(payload: bytes) -> bool:
    """Whether an Opus packet of one frame carries a coarse copy of the packet before it.

    That is the LBRR flag, which follows a voice activity flag for each 20 ms (RFC 6716 sections
    4.2.3 and 4.2.4); only SILK and hybrid frames have it. Packets of several frames: no.
    """
    flags = _silk_flags(payload)
    return flags is not None and bool(flags[0] & 0x80 >> flags[1])


def is_pause(payload: bytes) -> bool:
    """Whether an Opus packet of one frame says that nobody speaks in it: no voice activity flag
    is set (RFC 6716 section 4.2.3). False where there are none, as in CELT frames."""
    flags = _silk_flags(payload)
    return flags is not None and not flags[0] >> 8 - flags[1]


def _silk_flags(payload: bytes) -> tuple[int, int] | None:
    """The octet that holds the flags of a SILK or hybrid frame, and how many blocks it has."""
    begin = _only_frame(payload)
    config = payload[0] >> 3 if payload else 16
    if begin is None or begin >= len(payload) or config >= 16:
        return None
    return payload[begin], (1, 1, 2, 3)[config & 3] if config < 12 else 1


def _only_frame(payload: bytes) -> int | None:
    """Where the frame of a packet of one frame begins (RFC 6716 section 3.2); None: several."""
    if len(payload) < 2:
        return None
    if payload[0] & 3 == 0:
        return 1
    # Constant rate: one frame, and padding up to the size of all packets.
    if payload[0] & 3 != 3 or payload[1] & 0x3F != 1:
        return None
    at = 2
    if payload[1] & 0x40:
        while at < len(payload) and payload[at] == 0xFF:
            at += 1
        at += 1
    return at
