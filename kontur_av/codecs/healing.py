"""Which pictures are damaged after a loss, and when the intra refresh has healed them."""

from kontur_av.rtp.payload_h264 import NAL_SEI, ReceivedUnit, nal_type, split_annex_b

_SEI_RECOVERY_POINT = 6  # ITU-T H.264 table D-1


class Healing:
    """Follows a stream of access units in order.

    A loss damages every later picture, because each is predicted from the one before. An IDR
    picture heals at once. A recovery point SEI (ITU-T H.264 clause D.2.8) names the number of
    pictures after which all are right again, if none is lost.
    """

    def __init__(self) -> None:
        self._damaged = False
        self._left: int | None = None

    def handle_damage(self) -> None:
        """The decoder found damage in a picture: its octets are wrong, and none is missing."""
        self._damaged = True
        self._left = None

    def handle_unit(self, unit: ReceivedUnit) -> bool:
        """Return whether the picture of `unit` shows damage."""
        if unit.damaged or unit.lost_before:
            self._damaged = True
            self._left = None
        if not self._damaged or unit.damaged:
            return self._damaged
        if self._left is None:
            self._left = 0 if unit.keyframe else recovery_pictures(unit.data)
        else:
            self._left = 0 if unit.keyframe else self._left - 1
        if self._left == 0:
            self._damaged = False
            self._left = None
        return self._damaged


def recovery_pictures(access_unit: bytes) -> int | None:
    """Return recovery_frame_cnt of the recovery point SEI in an access unit (ITU-T H.264 D.2.8).

    access_unit: an Annex B byte stream. None if there is no such SEI, or it is malformed.
    """
    for nal in split_annex_b(access_unit):
        if nal_type(nal) == NAL_SEI:
            found = _recovery_point(nal[1:].replace(b"\0\0\3", b"\0\0"))
            if found is not None:
                return found
    return None


def _recovery_point(messages: bytes) -> int | None:
    at = 0
    while at + 2 <= len(messages):
        kind, at = _number(messages, at)
        size, at = _number(messages, at)
        if kind == _SEI_RECOVERY_POINT:
            return _exp_golomb(messages[at : at + size])
        at += size
    return None


def _number(messages: bytes, at: int) -> tuple[int, int]:
    """Return a payloadType or payloadSize (ITU-T H.264 clause 7.3.2.3.1), and where it ends."""
    value = 0
    while at < len(messages) and messages[at] == 0xFF:
        value += 0xFF
        at += 1
    return value + (messages[at] if at < len(messages) else 0), at + 1


def _exp_golomb(data: bytes) -> int | None:
    """Return the first ue(v) (ITU-T H.264 clause 9.1), of at most 16 bits like frame numbers."""
    bits = "".join(f"{octet:08b}" for octet in data[:5])
    zeros = len(bits) - len(bits.lstrip("0"))
    code = bits[zeros : 2 * zeros + 1]
    return int(code, 2) - 1 if zeros <= 16 and len(code) == zeros + 1 else None
