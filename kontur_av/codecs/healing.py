"""Which pictures are damaged after a loss, and when later ones are whole again."""

from collections.abc import Iterator

from kontur_av.media import VIDEO_CLOCK_HZ, VideoCodec
from kontur_av.modular import serial_difference
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.nal_formats import NAL_FORMATS

_SEI_USER_DATA, _SEI_RECOVERY_POINT = 5, 6  # ITU-T H.264 table D-1
#: uuid_iso_iec_11578 of `healing_message`, drawn at random.
_HEALING = bytes.fromhex("5d2f8a61c47b4e9ab3f6d81ce29047a5")


class Healing:
    """Follows a stream of access units in order.

    A loss damages every later picture, because each is predicted from the one before. An IDR
    picture heals at once. A recovery point SEI (ITU-T H.264 clause D.2.8) names the number of
    pictures after which all are right again, if none is lost. Pictures shown before that one, but
    coded after it (B pictures of an open GOP), may still refer to damaged ones. A
    `healing_message` heals at once if it names a picture that is whole.
    """

    def __init__(self) -> None:
        #: RTP timestamp of the newest picture that was decoded exactly.
        self.whole: int | None = None
        self._damaged = False
        self._left: int | None = None
        #: RTP timestamp of the picture at which the last wave ended, until later ones come.
        self._healed_at: int | None = None
        self._begun = False
        #: Whether pictures before the last key picture are missing or damaged.
        self._past_lost = True

    @property
    def damaged(self) -> bool:
        """Whether later pictures are damaged, too, until a key picture or a wave."""
        return self._damaged

    @property
    def in_wave(self) -> bool:
        """Whether a refresh wave heals the pictures now."""
        return self._left is not None

    def handle_damage(self) -> None:
        """The decoder found damage in a picture: its octets are wrong, and none is missing."""
        self._damaged = True
        self._left = None

    def handle_unit(self, unit: ReceivedUnit) -> bool:
        """Return whether the picture of `unit` shows damage."""
        if unit.damaged or unit.lost_before:
            self._damaged = True
            self._left = None
        if unit.keyframe:
            self._past_lost = self._damaged or not self._begun
            self._begun = True
        if not self._damaged and self._healed_at is not None:
            earlier = (self._healed_at - unit.timestamp) % 2**32
            if 0 < earlier < VIDEO_CLOCK_HZ and not unit.keyframe:
                return True
            self._healed_at = None
        if not self._damaged or unit.damaged:
            return self._damaged
        if self._heals(unit):
            self._damaged, self._left = False, None
            return False
        if self._left is None:
            self._left = 0 if unit.keyframe else recovery_pictures(unit.data, unit.codec)
        else:
            self._left = 0 if unit.keyframe else self._left - 1
        if self._left == 0:
            self._damaged = False
            self._left = None
            self._healed_at = None if unit.keyframe else unit.timestamp
        return self._damaged

    def _heals(self, unit: ReceivedUnit) -> bool:
        if self.whole is None or unit.codec != "h264":
            return False
        refers_to = newest_reference(unit.data)
        return refers_to is not None and serial_difference(self.whole - refers_to) >= 0

    def lacks_references(self, unit: ReceivedUnit) -> bool:
        """Return whether `unit`, the last one handled, refers to pictures that are not right.

        No other picture needs such leading pictures of HEVC (ITU-T H.265 clause 8.1.3).
        """
        return unit.leading and self._past_lost


def recovery_pictures(access_unit: bytes, codec: VideoCodec = "h264") -> int | None:
    """Return recovery_frame_cnt of the recovery point SEI in an access unit (ITU-T H.264 D.2.8).

    access_unit: an Annex B byte stream. None if there is no such SEI, or it is malformed.
    HEVC counts pictures in display order (ITU-T H.265 clause D.3.8), which is the same without B
    pictures.
    """
    for kind, payload in _messages(access_unit, codec):
        if kind == _SEI_RECOVERY_POINT and (coded := _exp_golomb(payload)) is not None:
            # se(v) of a count that is not negative is 0, 1, 3, 5 … (clause 9.2.2 of H.265).
            return (coded + 1) // 2 if codec == "h265" else coded
    return None


def healing_message(refers_to: int) -> bytes:
    """Return an SEI for H.264, as Annex B: this picture and later ones refer to none between.

    refers_to: 32-bit RTP timestamp of a picture. Between it and this one lie those that they do not
    refer to. The message is user data (ITU-T H.264 clause D.2.7): a UUID, then the timestamp in 5
    octets of 7 bits, the highest bit of each set, so that none needs emulation prevention.
    """
    coded = bytes(refers_to >> shift & 0x7F | 0x80 for shift in (28, 21, 14, 7, 0))
    payload = _HEALING + coded
    return join_annex_b([bytes((6, _SEI_USER_DATA, len(payload))) + payload + b"\x80"])


def newest_reference(access_unit: bytes) -> int | None:
    """Return the RTP timestamp of the `healing_message` in an access unit; None if it has none."""
    for kind, payload in _messages(access_unit, "h264"):
        if kind == _SEI_USER_DATA and payload[:16] == _HEALING and len(payload) == 21:
            found = 0
            for octet in payload[16:]:
                found = found << 7 | octet & 0x7F
            return found & 0xFFFF_FFFF
    return None


def _messages(access_unit: bytes, codec: VideoCodec) -> Iterator[tuple[int, bytes]]:
    """Yield payloadType and payload of each SEI message (ITU-T H.264 clause 7.3.2.3.1)."""
    form = NAL_FORMATS[codec]
    for nal in split_annex_b(access_unit):
        if form.nal_type(nal) != form.sei:
            continue
        messages, at = nal[form.header_octets :].replace(b"\0\0\3", b"\0\0"), 0
        while at + 2 <= len(messages):
            kind, at = _number(messages, at)
            size, at = _number(messages, at)
            yield kind, messages[at : at + size]
            at += size


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
