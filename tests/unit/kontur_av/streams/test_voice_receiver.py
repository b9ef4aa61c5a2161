"""The receiver of a voice, and what a listener hears: a lost packet is never silence."""

from itertools import pairwise

import numpy as np
import pytest
from voice_ends import PACKET, make_voice_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs import libopus
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES, OpusDecoder, OpusEncoder
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_NS, CaptureStamp, Quality
from kontur_av.rtp.payload_opus import holds_copy
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.rtp.wire import pack_rtp
from kontur_av.streams.voice_receiver import VoicePlayer, VoiceReceiver
from telepresence.world.scenes import read_speech

LOOKAHEAD_NS = LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
BLOCK = 960


def take(receiver, until_ns):
    """Return the blocks that are due by then."""
    blocks = []
    while (due_ns := receiver.poll_timeout()) is not None and due_ns <= until_ns:
        receiver.handle_timeout(due_ns)
        receiver.poll_feedback(due_ns)
        blocks += iter(receiver.next_event, None)
    return [*blocks, *iter(receiver.next_event, None)]


def talk(receiver, blocks, *, lost=(), reports=True, before=lambda now_ns: None):
    """Send blocks as soon as they are whole; yield each that is heard, and its capture."""
    sender = make_voice_sender(cap_bps=16_000)
    for number in range(blocks):
        now_ns = number * BLOCK_NS + BLOCK_NS
        before(now_ns)
        stamp = CaptureStamp(number * BLOCK_NS, number, "mic")
        assert sender.handle_block(stamp, now_ns)
        sender.handle_packet(PACKET, stamp, now_ns)
        packet = sender.poll_transmit(now_ns)
        if (report := sender.poll_report(now_ns)) is not None and reports:
            receiver.handle_report(report, now_ns)
        if number not in lost:
            receiver.handle_packet(packet, now_ns)
        event = sender.next_event()
        assert (event.encoded_ns, event.sent_ns) == (now_ns, now_ns)
        assert event.capture_ns == stamp.capture_ns - LOOKAHEAD_NS
        for block in take(receiver, now_ns + BLOCK_NS - 1):
            yield block, receiver.capture_ns(block.timestamp)


def test_sound_is_dated_when_heard_and_a_lost_block_is_marked():
    receiver = VoiceReceiver(name="voice")
    stamps = [
        receiver.handle_sound(block, decoded=block.payload is not None, capture_ns=capture_ns)
        for block, capture_ns in talk(receiver, 20, lost={10})
    ]
    assert [stamp.sequence for stamp in stamps] == list(range(len(stamps)))
    assert {stamp.quality for stamp in stamps} == {Quality.FRESH, Quality.CONCEALED}
    lost = [stamp for stamp in stamps if stamp.quality is Quality.CONCEALED]
    assert [round((stamp.capture_ns + LOOKAHEAD_NS) / BLOCK_NS) for stamp in lost] == [10]
    assert len(receiver.take_arrivals()) == 19
    assert receiver.take_arrivals() == []
    counts = receiver.counts
    assert (counts.rtp.rtp_packets, counts.frames_concealed, counts.frames_corrupt) == (19, 1, 0)
    assert (counts.frames_undated, counts.inserted_ns) == (0, 0)


@pytest.mark.parametrize(("lip_sync", "wait_ms"), [(True, 78), (False, None)])
def test_sound_waits_for_the_pictures_of_its_place(lip_sync, wait_ms):
    limits = {"oldest_picture_ns": 300 * NS_PER_MS, "oldest_sound_ns": 150 * NS_PER_MS}
    receiver = VoiceReceiver(**limits if lip_sync else {})

    def show(now_ns):
        # A picture of 120 ms, which sound may be ahead of by 45 ms; the margin is 3 ms.
        receiver.handle_picture_shown(now_ns, 120 * NS_PER_MS)

    *_, (block, capture_ns) = talk(receiver, 300, before=show)
    latency_ns = block.play_ns - capture_ns
    if wait_ms is None:
        assert latency_ns < 50 * NS_PER_MS
    else:
        assert abs(latency_ns - wait_ms * NS_PER_MS) < NS_PER_MS
    counts = receiver.counts
    # How long it waits above the quickest transit: a block, the look-ahead, and the wait.
    least_ns = BLOCK_NS + LOOKAHEAD_NS
    assert abs(latency_ns - counts.playout_delay_ns - least_ns) < NS_PER_MS
    assert counts.frames_received == counts.frames_decoded >= 290


def feed(receiver, numbers, step=960, payload=lambda number: PACKET):
    """Hand over packets in their time, whose timestamps advance by `step`; return the blocks."""
    blocks, fields = [], {"payload_type": 97, "marker": False, "ssrc": 5}
    for number in numbers:
        packet = pack_rtp(payload(number), sequence=number, timestamp=number * step, **fields)
        receiver.handle_packet(packet, number * BLOCK_NS)
        blocks += take(receiver, number * BLOCK_NS)
    return blocks


def test_timestamps_that_count_too_slowly_are_multiplied():
    receiver = VoiceReceiver()
    stamps = [block.timestamp for block in feed(receiver, range(40), 480) if block.payload][8:]
    assert {(later - early) % 2**32 for early, later in pairwise(stamps)} == {960}
    assert len(receiver.take_arrivals()) == 40


def test_undated_inserted_and_invalid_sound_is_counted():
    receiver = VoiceReceiver()
    block, capture_ns = next(talk(receiver, 5, reports=False))
    assert receiver.handle_sound(block, decoded=True, capture_ns=capture_ns) is None
    assert receiver.handle_sound(block, decoded=False, capture_ns=1).quality is Quality.CONCEALED
    assert (receiver.counts.frames_undated, receiver.counts.frames_corrupt) == (1, 1)
    receiver = VoiceReceiver()
    inserted = PlayoutBlock(None, 0, 480, 0, 480, inserted=True)
    stamp = receiver.handle_sound(inserted, decoded=False, capture_ns=7)
    assert (stamp.capture_ns, stamp.quality, stamp.source) == (7, Quality.CONCEALED, "voice")
    broken = PlayoutBlock(b"\xff", 5, 960, 0, 960)
    assert receiver.handle_sound(broken, decoded=False, capture_ns=8).sequence == 1
    counts = receiver.counts
    assert (counts.inserted_ns, counts.frames_corrupt) == (10 * NS_PER_MS, 1)
    assert (counts.frames_decoded, counts.frames_concealed) == (-1, 1)


def test_padding_is_no_sound_and_arrivals_that_nobody_takes_are_256():
    receiver = VoiceReceiver(ssrc=3, report_interval_ns=NS_PER_S)
    feed(receiver, range(300), payload=lambda number: b"" if number % 2 else PACKET)
    assert len(receiver.take_arrivals()) == 150
    feed(receiver, range(300, 600))
    arrivals = receiver.take_arrivals()
    assert len(arrivals) == 256
    assert (arrivals[-1].timestamp, arrivals[-1].received_ns) == (599 * 960, 599 * BLOCK_NS)
    # Nobody has said yet where reports go.
    assert receiver.poll_feedback(10**12) is None


def packets(bitrate_bps, sound, *, copies=False):
    encoder = OpusEncoder(bitrate_bps=bitrate_bps)
    if copies:
        control = libopus.opuslib().api.ctl
        for setting, value in ((control.set_inband_fec, 1), (control.set_packet_loss_perc, 20)):
            state = encoder._encoder.encoder_state
            libopus.opuslib().api.encoder.encoder_ctl(state, setting, value)
    return [encoder.encode(sound[at : at + BLOCK]) for at in range(0, len(sound) - BLOCK, BLOCK)]


def play(player, payload, samples=BLOCK, played=BLOCK, **what):
    return player.play(PlayoutBlock(payload, 0, samples, 0, played, **what))


def warmed(sent):
    """Return a player that has heard these packets."""
    player = VoicePlayer()
    for packet in sent:
        play(player, packet)
    return player


def energy(sound):
    return float(np.mean(sound.astype(np.float64) ** 2))


def voiced(sound):
    """Return blocks in the middle of speech: as loud as those around them."""
    level = [energy(sound[at : at + BLOCK]) for at in range(0, len(sound) - BLOCK, BLOCK)]
    loud = np.percentile(level, 60)
    return [n for n in range(5, len(level) - 2) if min(level[n - 1 : n + 2]) > loud]


@pytest.mark.parametrize("bitrate_bps", [7_600, 61_200])
def test_one_lost_packet_is_never_silence(bitrate_bps):
    sound = read_speech("ground").samples
    sent, chosen = packets(bitrate_bps, sound), voiced(sound)[::14]
    assert len(chosen) > 4
    for lost in chosen:
        player = warmed(sent[max(0, lost - 25) : lost - 1])
        before, made_up, after = (
            energy(play(player, packet)[0]) for packet in (sent[lost - 1], None, sent[lost + 1])
        )
        assert made_up > min(before, after) / 20, f"block {lost}"


def test_invalid_opus_is_concealed_with_any_length():
    player = warmed(packets(61_200, read_speech("cabin").samples[:48_000])[:20])
    for payload, samples in ((b"\xff\xff", BLOCK), (None, 120), (None, 700), (None, BLOCK)):
        sound, decoded = play(player, payload, samples, samples, inserted=payload is None)
        assert (len(sound), decoded) == (samples, False)


def test_a_copy_in_the_next_packet_is_better_than_a_guess():
    sound = read_speech("ground").samples
    sent = packets(24_000, sound, copies=True)
    assert sum(map(holds_copy, sent)) > len(sent) // 2
    assert not any(map(holds_copy, packets(7_600, sound[:96_000], copies=True))), "none is made"
    whole = OpusDecoder()
    true = [whole.decode(packet) for packet in sent]
    errors = {True: 0.0, False: 0.0}
    for lost in voiced(sound)[::15]:
        if not holds_copy(sent[lost + 1]):
            continue
        for recovered in errors:
            player = warmed(sent[max(0, lost - 40) : lost])
            got, _ = play(player, sent[lost + 1] if recovered else None, recovered=recovered)
            # The player's interpolation delays by two samples.
            errors[recovered] += energy(got[2:].astype(np.float64) - true[lost][:-2])
    assert 0 < errors[True] < 0.5 * errors[False]


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
    player, decoder = warmed(sent[:5]), OpusDecoder()
    tail = [decoder.decode(packet) for packet in sent[:5]][-1][-3:]
    sound, real = play(player, sent[5], played=played)
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
    assert list(play(player, sent[6])[0][:2]) == list(line[-2:])
