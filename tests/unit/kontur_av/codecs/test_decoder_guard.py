"""Forged streams cost bounded memory, and the next good stream is shown."""

from pathlib import Path

import pytest
from forged_streams import access_units, other_sets, sps

from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.decoder_guard import MOST_PICTURE_OCTETS, DecoderGuard, read_sps
from kontur_av.errors import ProtocolError
from kontur_av.media import VIDEO_CODECS
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b

SIZE = 320, 240
MB = 1 << 20

both = pytest.mark.parametrize("codec", VIDEO_CODECS)


def peak_growth(work):
    """Return by how many octets the memory of this process grew at most."""

    def told(key):
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) << 10 for line in lines if line.startswith(key))

    Path("/proc/self/clear_refs").write_text("5")
    before = told("VmRSS")
    work()
    return told("VmHWM") - before


def shown(decoder, units):
    return [len(decoder.decode(unit, number)) for number, unit in enumerate(units)]


@pytest.mark.rule("7")
@both
@pytest.mark.parametrize(
    "said",
    [
        {"width": 4096, "height": 4096},
        {"width": 4096, "height": 4096, "chroma": 3, "bits": 12},
        {"width": 640, "height": 480, "chroma": 3, "bits": 10},
        {"width": 16, "height": 1 << 20},
        {"width": 65536, "height": 65536},
    ],
)
def test_a_forged_sps_takes_no_memory_and_the_next_good_one_is_shown(codec, said):
    decoder = VideoDecoder(codec, size=SIZE)
    said = dict(said)
    forged = access_units(codec, said.pop("width"), said.pop("height"), **said)
    good = access_units(codec, *SIZE)
    assert sum(shown(decoder, good)) == len(good)

    def attack():
        assert sum(shown(decoder, forged)) == 0

    assert peak_growth(attack) < 16 * MB
    assert decoder.counts.sets_refused == 1
    assert decoder.counts.frames_corrupt == len(forged)
    # Pictures without parameter sets may be coded with the refused ones.
    assert sum(shown(decoder, good[1:])) == 0
    assert sum(shown(decoder, good)) == len(good)


@both
def test_without_a_size_a_decoder_takes_4k_of_10_bits_and_no_more(codec):
    for said, passes in (
        ({"width": 3840, "height": 2160, "bits": 10}, True),
        ({"width": 4096, "height": 2160, "bits": 10, "chroma": 2}, True),
        ({"width": 4096, "height": 4096}, True),
        ({"width": 3840, "height": 2160, "bits": 10, "chroma": 3}, False),
        ({"width": 4096, "height": 4112}, False),
    ):
        unit = join_annex_b([sps(codec, said.pop("width"), said.pop("height"), **said)])
        assert DecoderGuard(codec).admit(unit) == (unit if passes else b"")
    decoder = VideoDecoder(codec)
    assert shown(decoder, access_units(codec, 8192, 4096, count=1)) == [0]
    assert decoder.counts.sets_refused == 1


@both
def test_many_parameter_sets_and_sizes_take_bounded_memory(codec):
    decoder = VideoDecoder(codec, size=SIZE)

    def attack():
        for number in range(30):
            size = SIZE[0] - 16 * (number % 10), SIZE[1]
            sets = [sps(codec, *size, number=each) for each in range(16)]
            sets += [one for each in range(32) for one in other_sets(codec, each)]
            units = access_units(codec, *size, count=3)
            assert sum(shown(decoder, [join_annex_b(sets) + units[0], *units[1:]])) == 3

    assert peak_growth(attack) < 48 * MB


@both
def test_floods_of_sei_and_of_nal_units_are_left_out(codec):
    header = b"\x06" if codec == "h264" else b"\x4e\x01"
    sei = header + (b"\x05\x11" + bytes(range(1, 17)) + b"\x01") * 50_000 + b"\x80"
    unit, following = access_units(codec, *SIZE, count=2)
    decoder = VideoDecoder(codec, size=SIZE)

    def attack():
        assert shown(decoder, [join_annex_b([sei]) + unit]) == [1]
        slices = split_annex_b(following) * 5000
        assert shown(decoder, [join_annex_b(slices)]) == [0]

    assert peak_growth(attack) < 16 * MB
    little = join_annex_b([header + b"\x05\x11" + bytes(range(1, 17)) + b"\x01\x80"]) + unit
    assert DecoderGuard(codec).admit(little) == little
    # Of parameter sets 32 are read.
    sets, guard = (
        [sps(codec, *SIZE, number=number % 16) for number in range(64)],
        DecoderGuard(codec),
    )
    assert guard.admit(join_annex_b(sets[:32]))
    assert guard.admit(join_annex_b(sets)) == b""
    assert guard.sets_refused == 64


@both
def test_pictures_whose_sets_are_missing_are_counted_as_undecoded(codec):
    decoder = VideoDecoder(codec, size=SIZE)
    key, following = access_units(codec, *SIZE, count=2)
    slices = [
        nal for nal in split_annex_b(key) if nal not in (*other_sets(codec), sps(codec, *SIZE))
    ]
    assert shown(decoder, [join_annex_b(slices), following]) == [0, 0]
    assert decoder.counts.frames_before_start == 2
    assert shown(decoder, [key, following]) == [1, 1]


@both
def test_an_sps_that_is_cut_is_refused_until_a_good_one_comes(codec):
    unit = access_units(codec, *SIZE, count=1)[0]
    whole = sps(codec, *SIZE)
    for length in (3, 7):
        with pytest.raises(ProtocolError):
            read_sps(whole[:length], codec)
        decoder = VideoDecoder(codec, size=SIZE)
        assert shown(decoder, [unit.replace(whole, whole[:length]), unit]) == [0, 1]
        assert decoder.counts.sets_refused == 1


def test_an_sps_of_h264_that_tells_two_sizes_is_refused():
    """FFmpeg reads an SPS again with its escapes, where it cannot read it without."""
    nal = bytes.fromhex("6742001ed000000300bb1f28401b32200064c000017cfe40a0fc80")
    assert read_sps(nal, "h264").octets > MOST_PICTURE_OCTETS


def test_parameter_sets_of_other_views_of_hevc_are_left_out():
    unit = access_units("h265", *SIZE, count=1)[0]
    second = sps("h265", 65536, 65536)
    second = second[:1] + b"\x09" + second[2:]
    guard = DecoderGuard("h265")
    assert guard.admit(join_annex_b([second]) + unit) == unit
    assert guard.sets_refused == 0
