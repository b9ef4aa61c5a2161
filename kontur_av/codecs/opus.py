"""Blocks of sound to Opus packets of one constant size, and back (RFC 6716, RFC 7587)."""

import weakref
from dataclasses import replace
from typing import Any

import numpy as np

from kontur_av.clock import NS_PER_S
from kontur_av.codecs import libopus
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, MAX_OPUS_SAMPLES, CaptureStamp, Pcm

MAX_PACKET_SAMPLES = MAX_OPUS_SAMPLES

#: Samples that a packet may have: 10, 20, 40 or 60 ms. Voice mode has no shorter frames (RFC 6716
#: section 2.1.4).
FRAME_SAMPLES = (480, 960, 1920, 2880)
_LOWEST_BPS, _HIGHEST_BPS = 6_000, 510_000  # RFC 6716 section 2.1.1

#: How hard libopus searches: beyond 8 it finds nothing better (docs/experiments/voice.md).
_COMPLEXITY = 8
_SIGNAL_VOICE = 3001  # OPUS_SIGNAL_VOICE in opus_defines.h

# There are no in-band copies of the packet before (RFC 6716 section 2.1.7), for the reasons there.


def bitrate_under_cap(cap_bps: int, frame_samples: int = BLOCK_SAMPLES) -> int:
    """Return the largest constant bit rate in bit/s that keeps a hard cap even when sends jitter.

    Two packets more than a second has fit into it, so one may be 20 ms early or late. A cap of
    8 kbit/s gives 19 octets a packet, 7600 bit/s; 64 kbit/s gives 153 octets, 61 200 bit/s.

    Raises ConfigError, which names the cap, where Opus has no such rate: below 6.24 and above
    530.4 kbit/s with packets of 20 ms.
    """
    packets = -(-AUDIO_CLOCK_HZ // frame_samples) + 2
    octets = cap_bps // 8 // packets
    least = -(-_LOWEST_BPS * frame_samples // (8 * AUDIO_CLOCK_HZ))
    most = _HIGHEST_BPS * frame_samples // (8 * AUDIO_CLOCK_HZ)
    if not least <= octets <= most:
        of_octets = packets * 8 / 1000
        raise ConfigError(
            f"a cap of {cap_bps / 1000:g} kbit/s: Opus voice takes {least * of_octets:g} to "
            f"{most * of_octets:g}"
        )
    return -(-octets * 8 * AUDIO_CLOCK_HZ // frame_samples)


#: libopus' look-ahead at 48 kHz, in every mode but restricted low delay. The sound of a packet
#: begins this many samples before its block.
LOOKAHEAD_SAMPLES = 312


def heard_stamp(stamp: CaptureStamp) -> CaptureStamp:
    """Return the stamp of the sound that a listener hears from the packet of this block.

    It is earlier by the codec's look-ahead, which latencies and lip-sync then include.
    """
    lookahead_ns = LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
    return replace(stamp, capture_ns=stamp.capture_ns - lookahead_ns)


class OpusEncoder:
    """Opus in voice mode: mono, 48 kHz, constant bit rate. Every packet has `packet_octets` octets.

    bitrate_bps: bits a second of Opus packets, headers left out. With 20 ms a packet, 8000 bit/s
        give 20 octets, 64 000 bit/s 160.
    frame_samples: samples a packet, one of `FRAME_SAMPLES`.
    complexity: of libopus, 0 to 10.

    Raises ConfigError for a rate or frame that Opus does not have, or without a libopus.
    """

    def __init__(
        self, *, bitrate_bps: int, frame_samples: int = BLOCK_SAMPLES, complexity: int = _COMPLEXITY
    ) -> None:
        if frame_samples not in FRAME_SAMPLES:
            raise ConfigError(f"Opus frame of {frame_samples} samples: take one of {FRAME_SAMPLES}")
        if not _LOWEST_BPS <= bitrate_bps <= _HIGHEST_BPS:
            raise ConfigError(
                f"Opus at {bitrate_bps} bit/s: take a rate from {_LOWEST_BPS} to {_HIGHEST_BPS}"
            )
        self.frame_samples = frame_samples
        self.packet_octets = bitrate_bps * frame_samples // (8 * AUDIO_CLOCK_HZ)
        self._encoder = libopus.opuslib().Encoder(AUDIO_CLOCK_HZ, 1, "voip")
        weakref.finalize(self, _free, self._encoder, "encoder_state")
        self._encoder.vbr = 0
        # The rate of whole octets, because libopus rounds the octets to the nearest.
        self._encoder.bitrate = self.packet_octets * 8 * AUDIO_CLOCK_HZ // frame_samples
        self._encoder.complexity = complexity
        # Never in the mode for music, whose concealment of a lost packet does not fade.
        self._encoder.signal = _SIGNAL_VOICE
        self.lookahead_samples: int = self._encoder.lookahead

    def encode(self, samples: Pcm) -> bytes:
        """Return one packet of `packet_octets` octets.

        samples: int16, shape (frame_samples,); ValueError for any other.
        """
        if samples.shape != (self.frame_samples,) or samples.dtype != np.int16:
            raise ValueError(f"{samples.dtype}{samples.shape}, not int16({self.frame_samples},)")
        packet: bytes = self._encoder.encode(samples.tobytes(), self.frame_samples)
        return packet

    def save(self) -> bytes:
        """Return the encoder's state, for `restore`."""
        return libopus.copy_state(self._encoder.encoder_state)

    def restore(self, state: bytes) -> None:
        """Go back to a state that this encoder gave, as if nothing had been encoded since."""
        libopus.set_state(self._encoder.encoder_state, state)


class OpusDecoder:
    """Opus packets to mono sound at 48 kHz, with concealment of missing packets."""

    def __init__(self, *, frame_samples: int = BLOCK_SAMPLES) -> None:
        opuslib = libopus.opuslib()
        self.frame_samples = frame_samples
        self._error: type[Exception] = opuslib.OpusError
        self._decoder = opuslib.Decoder(AUDIO_CLOCK_HZ, 1)
        self._decode = opuslib.api.decoder.libopus_decode
        self._pointer = opuslib.api.c_int16_pointer
        weakref.finalize(self, _free, self._decoder, "decoder_state")

    def decode(self, packet: bytes) -> Pcm:
        """Return the packet's samples, int16, shape (n,), n at most 5760.

        `conceal` then makes n samples, too. Raises ProtocolError if `packet` is no Opus packet; the
        decoder goes on with the next one.
        """
        if not packet:
            raise ProtocolError("an empty Opus packet")
        samples = self._received(packet, MAX_PACKET_SAMPLES)
        self.frame_samples = len(samples)
        return samples

    def recover(self, following: bytes, samples: int) -> Pcm:
        """Return a lost packet's sound from the coarse copy in the packet after it.

        It is in-band error correction (RFC 6716 section 2.1.7); without a copy, as `conceal`.
        Decode `following` afterwards as usual.

        Returns int16, shape (samples,). Raises ProtocolError if `following` is no Opus packet.
        """
        return self._received(following, samples, decode_fec=True)

    def conceal(self, samples: int | None = None) -> Pcm:
        """Return libopus' estimate of a missing packet, int16, shape (samples,); it fades out.

        samples: a multiple of 120 (2.5 ms), at most 5760. None: as many as the packet before had.
        """
        # libopus takes an empty packet for a lost one (opus_decode).
        return self._decoded(b"", samples or self.frame_samples)

    def _received(self, packet: bytes, most_samples: int, *, decode_fec: bool = False) -> Pcm:
        try:
            return self._decoded(packet, most_samples, decode_fec=decode_fec)
        except self._error as error:
            raise ProtocolError(f"no Opus packet: {error}") from error

    def _decoded(self, packet: bytes, most_samples: int, *, decode_fec: bool = False) -> Pcm:
        # opuslib makes a Python integer of each sample, which takes five times as long.
        pcm = np.empty(most_samples, np.int16)
        state, room = self._decoder.decoder_state, pcm.ctypes.data_as(self._pointer)
        samples = self._decode(state, packet, len(packet), room, most_samples, decode_fec)
        if samples < 0:
            raise self._error(samples)
        return pcm[:samples]


def _free(coder: Any, state: str) -> None:
    # When the interpreter ends, opuslib's own destructor would fail: its modules are gone by then.
    coder.__del__()
    delattr(coder, state)
