"""HEVC there and back: sizes, key pictures, waves, losses and garbage."""

import random
from fractions import Fraction

import av
import numpy as np
import pytest
from av.video.frame import PictureType

from kontur_av.codecs import encoder_settings
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.encoder_settings import H265Settings
from kontur_av.codecs.h26x import H265Encoder, recovery_point
from kontur_av.codecs.healing import Healing, recovery_pictures
from kontur_av.codecs.region import Region
from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.annex_b import join_annex_b
from kontur_av.rtp.nal_formats import H265
from kontur_av.rtp.nal_payload import ReceivedUnit

CAP_BPS, FPS, WIDTH, HEIGHT = 85_000, 30, 320, 240


def scene(number, width=WIDTH, height=HEIGHT):
    blocks = np.random.default_rng(5).integers(40, 200, (height // 8 + 20, width // 8 + 30))
    luma = np.kron(blocks.astype(np.uint8), np.ones((8, 8), np.uint8))
    picture = empty_picture(width, height)
    picture[height:] = 128
    picture[:height] = luma[number : number + height, 2 * number : 2 * number + width]
    return VideoFrame(picture, CaptureStamp(number * 33_000_000, number, "test"))


def encoder(**changes):
    options = {"width": WIDTH, "height": HEIGHT, "fps": FPS, "cap_bps": CAP_BPS}
    return H265Encoder(**(options | changes))


def psnr_db(one, other):
    return 10 * np.log10(255**2 / max(np.mean((one.astype(float) - other) ** 2), 1e-9))


def received(unit, **changes):
    fields = {"keyframe": unit.keyframe, "damaged": False, "lost_before": 0}
    return ReceivedUnit(
        unit.data, 0, **(fields | changes), first_received_ns=0, received_ns=0, codec="h265"
    )


def test_every_picture_is_one_unit_of_about_its_share_and_comes_back():
    coder, decoder = encoder(), VideoDecoder("h265")
    units = [coder.encode(scene(number)) for number in range(45)]
    assert [unit.keyframe for unit in units] == [True] + [False] * 44
    assert {unit.codec for unit in units} == {"h265"}
    share = CAP_BPS / 8 / FPS
    assert sum(len(unit.data) for unit in units[15:]) < 30 * share
    assert max(len(unit.data) for unit in units[15:]) < 1.4 * share
    for number, unit in enumerate(units):
        (picture,) = decoder.decode(unit.data, number)
        assert picture.timestamp == number
    assert psnr_db(picture.to_i420(), scene(44).data) > 26


def test_a_key_picture_on_request_lets_a_new_decoder_begin():
    coder = encoder(refresh_s=60)
    for number in range(5):
        coder.encode(scene(number))
    unit = coder.encode(scene(5), Coding(keyframe=True))
    assert unit.keyframe
    assert H265.parameter_sets(unit.data)
    assert len(VideoDecoder("h265").decode(unit.data, 5)) == 1


def test_a_decoder_that_joins_has_the_exact_picture_after_a_wave():
    coder = encoder(refresh_s=1.0)
    units = [coder.encode(scene(number)) for number in range(100)]
    begins = [at for at, unit in enumerate(units) if recovery_pictures(unit.data, "h265")]
    assert begins == [30, 60, 90]
    whole, late = VideoDecoder("h265"), VideoDecoder("h265")
    pictures = [whole.decode(unit.data, 0)[0].to_i420() for unit in units]
    shown = {}
    for at in range(30, 100):
        for picture in late.decode(units[at].data, at):
            shown[at] = picture.to_i420()
    assert min(shown) == 59
    # Loop filters at the edge of a wave are not exact.
    assert psnr_db(shown[95], pictures[95]) > 45


def test_after_a_loss_pictures_come_again_with_the_next_key_picture():
    coder, decoder, healing = encoder(refresh_s=60), VideoDecoder("h265"), Healing()
    units = [coder.encode(scene(number), Coding(keyframe=number == 12)) for number in range(20)]
    hurt, shown = [], []
    for number, unit in enumerate(units):
        if number == 5:
            continue
        hurt.append(healing.handle_unit(received(unit, lost_before=int(number == 6))))
        shown += [number for _ in decoder.decode(unit.data, number)]
    assert hurt == [False] * 5 + [True] * 6 + [False] * 8
    assert [number for number in shown if number >= 12] == list(range(12, 20))
    assert decoder.counts.frames_corrupt + len(shown) == 19


def test_without_feedback_a_wave_brings_the_picture_back_after_any_loss():
    coder, decoder = encoder(refresh_s=1.0), VideoDecoder("h265")
    units = [coder.encode(scene(number % 80)) for number in range(140)]
    whole = VideoDecoder("h265")
    exact = [whole.decode(unit.data, 0)[0].to_i420() for unit in units]
    # One amid the stream, and one amid the wave that would heal it: the next wave does.
    shown = {}
    for number, unit in enumerate(units):
        for picture in decoder.decode(unit.data, number) if number not in (40, 70) else ():
            shown[number] = picture.to_i420()
    assert list(shown) == [*range(40), *range(89, 140)]
    assert psnr_db(shown[125], exact[125]) > 45


def test_a_decoder_that_holds_key_pictures_back_returns_all_of_them():
    coder = av.CodecContext.create("libx265", "w")
    coder.width, coder.height, coder.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    coder.framerate, coder.time_base = Fraction(FPS), Fraction(1, FPS)
    parameters = "bframes=2:repeat-headers=1:annexb=1:log-level=error"
    coder.options = {"preset": "ultrafast", "forced-idr": "1", "x265-params": parameters}
    packets = []
    for number in range(8):
        picture = av.VideoFrame.from_ndarray(scene(number).data, "yuv420p")
        picture.pts, picture.pict_type = number, PictureType.I
        packets += coder.encode(picture)
    packets += coder.encode(None)
    decoder = VideoDecoder("h265", reordered=True)
    pictures = []
    for number, packet in enumerate(packets):
        pictures += decoder.decode(bytes(packet), number)
    pictures += decoder.drain()
    assert [picture.timestamp for picture in pictures] == list(range(8))


@pytest.mark.parametrize("pictures", [0, 1, 2, 29, 1799])
def test_recovery_points_are_read_as_written(pictures):
    unit = join_annex_b([recovery_point(pictures)])
    assert recovery_pictures(unit, "h265") == pictures


def test_garbage_ends_no_decoder():
    coder, decoder, draw = encoder(), VideoDecoder("h265"), random.Random(3)
    for number in range(60):
        data = bytearray(coder.encode(scene(number), Coding(keyframe=number % 20 == 0)).data)
        if number % 3:
            for _ in range(number % 7):
                data[draw.randrange(len(data))] = draw.randrange(256)
        for picture in decoder.decode(bytes(data), number):
            assert picture.to_i420().shape[1] == picture.width
    decoder.decode(draw.randbytes(400), 60)
    assert decoder.decode(coder.encode(scene(61), Coding(keyframe=True)).data, 61)


def test_a_picture_beyond_the_limit_is_not_decoded():
    """A forged SPS must not fill the memory."""
    settings = H265Settings(
        width=8192,
        height=4096,
        rate=Fraction(30),
        cap_bps=2_000_000,
        refresh_s=60,
        preset="ultrafast",
    )
    picture = av.VideoFrame(8192, 4096, "yuv420p")
    picture.pts = 0
    (packet,) = settings.open().encode(picture)
    decoder = VideoDecoder("h265")
    assert decoder.decode(bytes(packet), 0) == []
    assert decoder.counts.frames_before_start == 1


def test_cap_rate_and_region_change_as_those_of_h264():
    coder = encoder(regions=True, cap_bps=300_000)
    for number in range(6):
        coder.encode(scene(number), region=Region(0, 0, 64, 64, 6))
    unit = coder.encode(scene(6), Coding(rate_hz=15, cap_bps=100_000))
    assert unit.keyframe
    with pytest.raises(ValueError, match="without regions"):
        encoder().encode(scene(0), region=Region(0, 0, 64, 64))


def test_a_pyav_without_libx265_names_the_mend(monkeypatch):
    def unknown(name, mode):
        raise encoder_settings.av.codec.codec.UnknownCodecError(name)

    monkeypatch.setattr(encoder_settings.av.CodecContext, "create", unknown, raising=False)
    with pytest.raises(ConfigError, match="libx265"):
        encoder(fps=Fraction(30))
