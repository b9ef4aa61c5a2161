"""Packets of constant size, and restored sound."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.codecs.opus import (
    FRAME_SAMPLES,
    LOOKAHEAD_SAMPLES,
    OpusDecoder,
    OpusEncoder,
    bitrate_under_cap,
    heard_stamp,
)
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import CaptureStamp


def tone(samples, hz=300):
    return (9000 * np.sin(2 * np.pi * hz * np.arange(samples) / 48_000)).astype(np.int16)


def blocks(sound, size=960):
    return [sound[i : i + size] for i in range(0, sound.size - size + 1, size)]


@pytest.mark.parametrize(
    ("bitrate_bps", "octets"), [(8_000, 20), (64_000, 160), (7_600, 19), (61_200, 153)]
)
def test_every_packet_has_the_same_size(bitrate_bps, octets):
    noise = np.random.default_rng(1).integers(-32768, 32767, 96_000).astype(np.int16)
    sound = np.concatenate([tone(48_000), np.zeros(48_000, np.int16), noise])
    encoder = OpusEncoder(bitrate_bps=bitrate_bps)
    assert encoder.packet_octets == octets
    assert {len(encoder.encode(block)) for block in blocks(sound)} == {octets}


@pytest.mark.parametrize("frame_samples", FRAME_SAMPLES)
def test_sound_comes_back_later_by_the_lookahead(frame_samples):
    seconds = np.arange(48_000) / 48_000
    sound = (9000 * np.sin(2 * np.pi * (300 + 400 * seconds) * seconds)).astype(np.int16)
    encoder = OpusEncoder(bitrate_bps=64_000, frame_samples=frame_samples)
    decoder = OpusDecoder()
    heard = np.concatenate(
        [decoder.decode(encoder.encode(b)) for b in blocks(sound, frame_samples)]
    )
    likeness = [
        np.corrcoef(sound[9_600:38_400], heard[9_600 + late : 38_400 + late])[0, 1]
        for late in range(960)
    ]
    assert max(likeness) > 0.98
    # Voice mode's high-pass filter shifts the phase slightly: 1 ms is allowed.
    assert abs(int(np.argmax(likeness)) - encoder.lookahead_samples) <= 48
    # It counts for the latency.
    assert OpusEncoder(bitrate_bps=8_000).lookahead_samples == LOOKAHEAD_SAMPLES
    assert heard_stamp(CaptureStamp(10**9, 3, "mic")) == CaptureStamp(10**9 - 6_500_000, 3, "mic")


def test_a_lost_packet_is_filled_with_its_length_and_fades():
    encoder, decoder = OpusEncoder(bitrate_bps=64_000), OpusDecoder()
    for block in blocks(tone(48_000)):
        decoder.decode(encoder.encode(block))
    guesses = [decoder.conceal() for _ in range(40)]
    assert all(guess.shape == (960,) and guess.dtype == np.int16 for guess in guesses)
    assert np.abs(guesses[0]).max() > 1000
    assert np.abs(guesses[-1]).max() < 100


@given(st.binary(max_size=200))
def test_garbage_is_a_protocol_error_or_sound(packet):
    decoder = OpusDecoder()
    try:
        samples = decoder.decode(packet)
    except ProtocolError:
        pass
    else:
        assert samples.dtype == np.int16
        assert 0 < samples.size <= 5760
    encoder = OpusEncoder(bitrate_bps=8_000)
    assert decoder.decode(encoder.encode(tone(960))).shape == (960,)


@pytest.mark.parametrize("frame_samples", FRAME_SAMPLES)
def test_two_packets_more_in_a_second_keep_the_cap(frame_samples):
    packets = -(-48_000 // frame_samples) + 2
    for cap_bps in (8_000, 24_000, 64_000):
        bitrate_bps = bitrate_under_cap(cap_bps, frame_samples)
        octets = OpusEncoder(bitrate_bps=bitrate_bps, frame_samples=frame_samples).packet_octets
        assert packets * octets * 8 <= cap_bps < packets * (octets + 1) * 8
    for cap_bps in (0, 500, 6_000, 600_000):
        with pytest.raises(ConfigError, match=rf"^a cap of {cap_bps / 1000:g} kbit/s: "):
            bitrate_under_cap(cap_bps, frame_samples)


def test_an_accepted_cap_can_be_coded_and_invalid_settings_are_refused():
    for cap_bps in (6_240, 6_400, 6_401, 530_400):
        assert OpusEncoder(bitrate_bps=bitrate_under_cap(cap_bps)).packet_octets >= 15
    for wrong in ({"bitrate_bps": 5_000}, {"frame_samples": 961}):
        with pytest.raises(ConfigError):
            OpusEncoder(**{"bitrate_bps": 8_000, **wrong})
