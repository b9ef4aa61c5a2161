"""What a listener hears: no gaps, and a lost packet is never silence."""

import numpy as np
import pytest

from kontur_av.codecs import libopus
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES, OpusDecoder, OpusEncoder, heard_stamp
from kontur_av.media import CaptureStamp
from kontur_av.rtp.payload_opus import holds_copy
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.streams.voice_receiver import VoicePlayer
from telepresence.world.scenes import read_speech

BLOCK = 960


def energy(sound):
    return float(np.mean(sound.astype(np.float64) ** 2))


def packets(bitrate_bps, sound, *, copies=False):
    encoder = OpusEncoder(bitrate_bps=bitrate_bps)
    if copies:
        opuslib = libopus.opuslib()
        for setting, value in (
            (opuslib.api.ctl.set_inband_fec, 1),
            (opuslib.api.ctl.set_packet_loss_perc, 20),
        ):
            opuslib.api.encoder.encoder_ctl(encoder._encoder.encoder_state, setting, value)
    return [encoder.encode(sound[at : at + BLOCK]) for at in range(0, len(sound) - BLOCK, BLOCK)]


def block(payload, samples=BLOCK, played=BLOCK, **what):
    return PlayoutBlock(payload, 0, samples, 0, played, **what)


def voiced(sound):
    """Return blocks in the middle of speech: as loud as those around them."""
    level = [energy(sound[at : at + BLOCK]) for at in range(0, len(sound) - BLOCK, BLOCK)]
    loud = np.percentile(level, 60)
    return [n for n in range(5, len(level) - 2) if min(level[n - 1 : n + 2]) > loud]


@pytest.mark.parametrize("bitrate_bps", [7_600, 61_200])
def test_one_lost_packet_is_never_silence(bitrate_bps):
    sound = read_speech("ground").samples
    sent = packets(bitrate_bps, sound)
    chosen = voiced(sound)[::7]
    assert len(chosen) > 5
    for lost in chosen:
        player = VoicePlayer()
        heard = [
            player.play(block(None if number == lost else packet))[0]
            for number, packet in enumerate(sent[: lost + 2])
        ]
        around = min(energy(heard[lost - 1]), energy(heard[lost + 1]))
        assert energy(heard[lost]) > around / 20, f"block {lost}"


@pytest.mark.parametrize("played", [936, 950, 960, 961, 984])
def test_a_block_is_played_in_exactly_the_time_it_is_given(played):
    tone = (9000 * np.sin(2 * np.pi * 440 * np.arange(48_000) / 48_000)).astype(np.int16)
    player = VoicePlayer()
    heard = [player.play(block(packet, played=played))[0] for packet in packets(61_200, tone)]
    assert {len(sound) for sound in heard} == {played}
    line = np.concatenate(heard[10:]).astype(np.float64)
    # The same tone, shifted by the ratio, without clicks: no jump larger than the tone's own.
    hz = 440 * BLOCK / played
    assert np.abs(np.diff(line)).max() < 1.1 * 9000 * 2 * np.pi * hz / 48_000
    spectrum = np.abs(np.fft.rfft(line * np.hanning(len(line))))
    peak_hz = np.argmax(spectrum) * 48_000 / len(line)
    assert peak_hz == pytest.approx(hz, abs=1.5)


def test_invalid_opus_is_concealed_with_any_length():
    sent = packets(61_200, read_speech("cabin").samples[:48_000])
    player = VoicePlayer()
    for packet in sent[:20]:
        player.play(block(packet))
    sound, decoded = player.play(block(b"\xff\xff"))
    assert (len(sound), decoded) == (BLOCK, False)
    for samples in (120, 700, BLOCK):
        sound, decoded = player.play(block(None, samples, samples, inserted=True))
        assert (len(sound), decoded) == (samples, False)


def test_a_copy_in_the_next_packet_is_better_than_a_guess():
    sound = read_speech("ground").samples
    sent = packets(24_000, sound, copies=True)
    assert sum(map(holds_copy, sent)) > len(sent) // 2
    assert not any(map(holds_copy, packets(7_600, sound, copies=True))), "libopus makes none"
    whole = OpusDecoder()
    true = [whole.decode(packet) for packet in sent]
    errors = {True: 0.0, False: 0.0}
    for lost in voiced(sound)[::9]:
        if not holds_copy(sent[lost + 1]):
            continue
        for recovered in errors:
            player = VoicePlayer()
            for packet in sent[:lost]:
                player.play(block(packet))
            payload = sent[lost + 1] if recovered else None
            got, _ = player.play(block(payload, recovered=recovered))
            # The player's interpolation delays by two samples.
            difference = got[2:].astype(np.float64) - true[lost][:-2]
            errors[recovered] += float(difference @ difference)
    assert errors[True] < 0.5 * errors[False]


@pytest.mark.parametrize("payload", [b"", b"\x08", b"\x0b\x01\x02", b"\xf8\xff"])
def test_packets_without_a_copy_are_recognized(payload):
    assert not holds_copy(payload)


def test_the_look_ahead_counts_for_the_latency():
    assert OpusEncoder(bitrate_bps=8_000).lookahead_samples == LOOKAHEAD_SAMPLES
    assert heard_stamp(CaptureStamp(10**9, 3, "mic")) == CaptureStamp(10**9 - 6_500_000, 3, "mic")


def catmull_rom(line, at):
    """The spline of E. Catmull and R. Rom through every sample, by its weights."""
    index, t = int(at), at - int(at)
    weights = (
        (-(t**3) + 2 * t**2 - t) / 2,
        (3 * t**3 - 5 * t**2 + 2) / 2,
        (-3 * t**3 + 4 * t**2 + t) / 2,
        (t**3 - t**2) / 2,
    )
    return sum(w * line[index + k] for w, k in zip(weights, (-1, 0, 1, 2), strict=True))


@pytest.mark.parametrize("played", [480, 700, 935, 936, 960, 984, 985, 1440])
def test_a_block_of_another_length_is_resampled_or_its_ends_overlap(played):
    sent = packets(61_200, read_speech("ground").samples[20_000:30_000])
    player, decoder = VoicePlayer(), OpusDecoder()
    for packet in sent[:5]:
        player.play(block(packet))
        tail = decoder.decode(packet)[-3:]
    sound, real = player.play(block(sent[5], played=played))
    line = np.concatenate([tail, decoder.decode(sent[5])]).astype(np.float64)
    assert real and len(sound) == played
    if abs(played - BLOCK) <= BLOCK // 40:
        expected = [catmull_rom(line, 1 + n * BLOCK / played) for n in range(played)]
    else:
        # The beginning, as long as it may be, fades into the end.
        whole = line[1 : 1 + BLOCK]
        fade = min(played, 2 * BLOCK - played)
        begin = played - BLOCK if played > BLOCK else 0
        share = (np.arange(fade) + 0.5) / fade
        end = whole[BLOCK - played + begin :][:fade] if played < BLOCK else whole[:fade]
        blend = whole[begin : begin + fade] * (1 - share) + end * share
        expected = np.concatenate([whole[:begin], blend, whole[fade:] if begin else whole[:0]])
    assert np.abs(sound - np.array(expected)).max() <= 0.51
    # The next one goes on behind it.
    following = player.play(block(sent[6]))[0]
    assert list(following[:2]) == list(line[-2:])
