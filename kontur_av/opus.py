"""Blocks of sound to Opus packets of one constant size, and back (RFC 6716, RFC 7587).

Of opuslib the functions are used, not the classes: those free their state in `__del__`, which
fails with a traceback when the interpreter ends first.
"""

import weakref

import numpy as np

from kontur_av import libopus
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm

#: Samples a packet may cover: 10, 20, 40 or 60 ms. Voice mode codes nothing shorter (RFC 6716
#: section 2.1.4).
FRAME_SAMPLES = (480, 960, 1920, 2880)
#: The longest packet that RFC 6716 allows: 120 ms.
MAX_PACKET_SAMPLES = 5760
_ROOM_OCTETS = 4000  # what opus_encode's documentation recommends
_LOWEST_BPS, _HIGHEST_BPS = 6_000, 510_000  # RFC 6716 section 2.1.1


def bitrate_under_cap(cap_bps: int, frame_samples: int = 960) -> int:
    """The largest bit rate of constant packets that keeps a hard cap even when sends jitter.

    At exactly `cap_bps` there is no room at all: one packet that leaves a millisecond early and
    a 1 s window holds 51 of them. Here 52 packets of 20 ms still fit (8 kbit/s: 19 octets each,
    7600 bit/s; 64 kbit/s: 153 octets, 61 200 bit/s), so a packet may be 20 ms early or late.
    """
    packets = -(-AUDIO_CLOCK_HZ // frame_samples) + 2
    octets = cap_bps // 8 // packets
    return -(-octets * 8 * AUDIO_CLOCK_HZ // frame_samples)


class OpusEncoder:
    """Voice mode, mono, 48 kHz, hard constant bit rate: every packet has `packet_octets` octets.

    bitrate_bps: bits of the packets alone. 20 ms at 8000 bit/s give 20 octets, at 64 000 160.
    frame_samples: samples a packet, one of `FRAME_SAMPLES`.
    complexity: libopus' 0..10; at 8 kbit/s a 20 ms packet costs 0.2 ms at 5, 0.4 ms at 10.
    """

    def __init__(self, *, bitrate_bps: int, frame_samples: int = 960, complexity: int = 5) -> None:
        if frame_samples not in FRAME_SAMPLES:
            raise ConfigError(f"Opus frame of {frame_samples} samples: take one of {FRAME_SAMPLES}")
        if not _LOWEST_BPS <= bitrate_bps <= _HIGHEST_BPS:
            raise ConfigError(
                f"Opus at {bitrate_bps} bit/s: take a rate from {_LOWEST_BPS} to {_HIGHEST_BPS}"
            )
        opuslib = libopus.opuslib()
        self._api, ctl = opuslib.api.encoder, opuslib.api.ctl
        self.frame_samples = frame_samples
        self.packet_octets = bitrate_bps * frame_samples // (8 * AUDIO_CLOCK_HZ)
        self._state = self._api.create_state(AUDIO_CLOCK_HZ, 1, opuslib.APPLICATION_VOIP)
        weakref.finalize(self, self._api.destroy, self._state)
        # The rate of whole octets, because libopus rounds the octets to the nearest.
        whole_bps = self.packet_octets * 8 * AUDIO_CLOCK_HZ // frame_samples
        for setting, value in (
            (ctl.set_vbr, 0),
            (ctl.set_bitrate, whole_bps),
            (ctl.set_complexity, complexity),
        ):
            self._api.encoder_ctl(self._state, setting, value)
        self.lookahead_samples: int = self._api.encoder_ctl(self._state, ctl.get_lookahead)

    def encode(self, samples: Pcm) -> bytes:
        """One packet of `packet_octets` octets from int16 samples of shape (frame_samples,)."""
        if samples.shape != (self.frame_samples,) or samples.dtype != np.int16:
            raise ValueError(f"{samples.dtype}{samples.shape}, not int16({self.frame_samples},)")
        packet: bytes = self._api.encode(
            self._state, samples.tobytes(), self.frame_samples, _ROOM_OCTETS
        )
        return packet


class OpusDecoder:
    """Opus packets to mono sound at 48 kHz, and something to hear where a packet is missing."""

    def __init__(self, *, frame_samples: int = 960) -> None:
        opuslib = libopus.opuslib()
        self.frame_samples = frame_samples
        self._error: type[Exception] = opuslib.OpusError
        self._api = opuslib.api.decoder
        self._state = self._api.create_state(AUDIO_CLOCK_HZ, 1)
        weakref.finalize(self, self._api.destroy, self._state)

    def decode(self, packet: bytes) -> Pcm:
        """The packet's samples, int16 of shape (n,) with n up to 5760; also sets the length that
        `conceal` stands in for.

        Raises ProtocolError on what is no Opus packet; the decoder goes on with the next one.
        """
        if not packet:
            raise ProtocolError("an empty Opus packet")
        try:
            sound = self._decode(packet, MAX_PACKET_SAMPLES)
        except self._error as error:
            raise ProtocolError(f"no Opus packet: {error}") from error
        samples = np.frombuffer(sound, np.int16)
        self.frame_samples = samples.size
        return samples

    def conceal(self) -> Pcm:
        """libopus' guess at one lost packet: int16 of shape (frame_samples,), fading out."""
        return np.frombuffer(self._decode(b"", self.frame_samples), np.int16)

    def _decode(self, packet: bytes, room_samples: int) -> bytes:
        sound: bytes = self._api.decode(
            self._state, packet, len(packet), room_samples, False, channels=1
        )
        return sound
