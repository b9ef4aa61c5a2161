"""Whole ends of a stream: a reader may be slow, see no dates, or be ended from outside."""

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common import free_port

import kontur_av as av
from kontur_av.clock import NS_PER_MS
from kontur_av.media import Quality
from kontur_av.rtp import parse_sdp, write_sdp

GREY = np.full((96, 128, 3), 90, np.uint8)

#: So many pictures at most: under load a receiver may begin late, and need a key picture first.
MOST = 10_000


def test_a_slow_reader_gets_the_newest_picture_and_the_end(tmp_path):
    port, sdp = free_port(), tmp_path / "s.sdp"
    with av.PictureSender(f"127.0.0.1:{port}", cap_bps=300_000, fps=120, sdp=sdp) as end:
        end.send(GREY)
        with av.StreamReceiver(sdp) as pictures:
            for _ in range(MOST):
                if pictures.skipped:
                    break
                end.send(GREY)
            # Within a second a packet tells its capture.
            for level in (*[90] * 130, *range(30)):
                end.send(np.full_like(GREY, level))
            end.close()
            while not pictures.ended:
                time.sleep(0.05)
            seen = list(pictures)
    assert len(seen) == 1 and pictures.skipped > 0
    assert abs(int(seen[0].data.mean()) - 29) <= 8
    assert seen[0].age_ms > 400
    assert pictures.ended == "goodbye"


@pytest.mark.parametrize("kind", ["pictures", "sound"])
def test_what_no_report_dates_comes_without_an_age(tmp_path, kind):
    port, sdp, elsewhere = free_port(), tmp_path / "s.sdp", free_port()
    while elsewhere == port + 1:
        elsewhere = free_port()
    cls, item = (
        (av.PictureSender, GREY)
        if kind == "pictures"
        else (av.SoundSender, np.ones(960, dtype=np.int16))
    )
    with cls(f"127.0.0.1:{port}", cap_bps=300_000, sdp=sdp) as end:
        end.send(item)
        # Its reports go where nobody hears them, and its packets' own dates are not told.
        stream = parse_sdp(sdp.read_text())
        sdp.write_text(write_sdp(replace(stream, rtcp_port=elsewhere, capture_time_id=None)))
        with av.StreamReceiver(sdp) as received, ThreadPoolExecutor() as pool:
            first = pool.submit(next, received)
            for _ in range(MOST):
                if first.done():
                    break
                end.send(item)
            first = first.result()
    assert first.age_ms is first.capture_ns is None and first.quality is Quality.FRESH
    assert first.data.shape == item.shape and first.data.dtype == item.dtype


@pytest.mark.parametrize("to", ["localhost", "[::1]"])
def test_size_number_and_capture_travel_and_a_restart_is_told(to):
    port, captured = free_port(), ({}, {})
    ends = [av.PictureSender(f"{to}:{port}", cap_bps=60_000, format="grey") for _ in captured]
    with ThreadPoolExecutor() as pool, av.StreamReceiver(port=port) as pictures:
        reading = pool.submit(list, pictures)
        for run, end in zip(captured, ends, strict=True):
            for number in range(30):
                run[number] = time.monotonic_ns()
                end.send(np.full((482, 640), 90 + number, np.uint8), capture_ns=run[number])
            end.close()
        seen = reading.result()
    assert pictures.ended == "goodbye" and {one.data.shape for one in seen} == {(482, 640, 3)}
    begun = [number for number, one in enumerate(seen) if one.restarted]
    assert len(begun) == 1
    for run, part in zip(captured, (seen[: begun[0]], seen[begun[0] :]), strict=True):
        numbers = [one.sequence for one in part]
        assert numbers and numbers == sorted(set(numbers))
        assert all(abs(one.capture_ns - run[one.sequence]) < NS_PER_MS for one in part)
        assert all(one.age_ms >= 0 and not one.damaged for one in part)
    data, age_ms, quality = seen[0]
    assert (data is seen[0].data, age_ms, quality) == (True, seen[0].age_ms, Quality.FRESH)


def test_a_source_is_sent_until_it_is_told_to_stop():
    port, seen, said = free_port(), [], []
    source = Path(__file__).parents[2] / "samples" / "clip.mp4"
    with ThreadPoolExecutor() as pool, av.StreamReceiver(port=port, size=(64, 48)) as pictures:
        reading = pool.submit(lambda: seen.extend(pictures))
        report = av.send(
            str(source),
            f"localhost:{port}",
            cap_bps=np.float64(250e3),
            size=(320, 242),
            # Until the sender has answered what its time is.
            stopped=lambda: len(seen) > 5 and said and seen[-1].error_ns,
            say=said.append,
            seconds=60,
        )
        reading.result()
    assert {one.data.shape for one in seen} == {(48, 64, 3)} and pictures.ended == "goodbye"
    assert report.failed == [] and report.size == (320, 242)
    assert report.sender.frames_sent > 5 and 0 < report.payload_bps_max_1s <= report.cap_bps
    assert said[0].count("kbit/s") == 1 and seen[-1].error_ns is not None


async def test_an_async_reader_is_ended_from_outside(tmp_path):
    port, sdp = free_port(), tmp_path / "s.sdp"
    seen = sent = 0

    async def read(pictures):
        nonlocal seen
        async for _ in pictures:
            seen += 1

    sending = av.PictureSender(f"127.0.0.1:{port}", cap_bps=300_000, fps=120, sdp=sdp)
    async with sending as end:
        await end.asend(GREY)
        async with av.StreamReceiver(sdp) as pictures:
            reading = asyncio.create_task(read(pictures))
            while seen <= 5 and sent < MOST:
                await end.asend(GREY)
                sent += 1
            await asyncio.to_thread(pictures.close)
            await reading
    assert seen > 5 and pictures.ended == "closed"
    assert 5 < end.counts.frames_sent <= sent + 1 and 0 < end.largest_bps <= 300_000
    assert seen + pictures.skipped <= end.counts.frames_sent
