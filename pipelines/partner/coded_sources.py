"""A source of pictures and one of sound for a partner, coded in threads of their own. A shell.

A source waits for its device, and coding takes milliseconds: neither may hold up the event loop.
"""

import asyncio
import threading
from collections.abc import Callable
from typing import Any

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.closing import Closing
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.opus import OpusEncoder, heard_stamp
from kontur_av.media import AccessUnit, CaptureStamp, VideoFrame, empty_picture
from kontur_av.meters import RateMeter
from kontur_av.sources import AudioSource, VideoSource
from pipelines.partner.decisions import PicturePlan, RateFollower

_TIMEOUT_NS = 50 * NS_PER_MS
_LAST_S = 2.0


class CodedSources(Closing):
    """Codes the sources while somebody takes what comes. A context manager.

    most_bps: of the picture. send_unit, send_opus: called on the event loop.
    """

    def __init__(
        self,
        clock: MonotonicClock,
        *,
        most_bps: int,
        send_unit: Callable[[AccessUnit], None],
        send_opus: Callable[[bytes, CaptureStamp], None],
    ) -> None:
        self._clock = clock
        self._send_unit, self._send_opus = send_unit, send_opus
        self._loop = asyncio.get_running_loop()
        self._ended = threading.Event()
        #: Whether anybody takes what is coded.
        self.wanted = False
        self.rate = RateFollower(most_bps=most_bps)
        self.sent = RateMeter()
        self._keys = 0
        self.coded = {"video": 0, "audio": 0}
        #: Why a source has ended; "" if none has.
        self.fault = ""
        self._threads: list[threading.Thread] = []

    def add_pictures(self, source: VideoSource, encoder: H264Encoder) -> None:
        plan = PicturePlan(bps=self.rate.bps)
        self._begin("pictures", self._pictures, source, encoder, plan)

    def add_sound(self, source: AudioSource, encoder: OpusEncoder) -> None:
        self._begin("sound", self._sound, source, encoder)

    def want_key(self) -> None:
        self._keys += 1

    def close(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(_LAST_S)

    def handle_request(self, requested_bps: int | None) -> None:
        """Follow what the partners can take (REMB). Call it a few times a second."""
        now_ns = self._clock.now_ns()
        self.rate.handle_request(requested_bps, self.sent.last_bps(now_ns), now_ns)

    def _count_and_send(self, unit: AccessUnit) -> None:
        self.sent.add(self._clock.now_ns(), len(unit.data))
        self._send_unit(unit)

    def _begin(self, name: str, run: Callable[..., None], source: Any, *rest: Any) -> None:
        def guarded() -> None:
            try:
                run(source, *rest)
            except Exception as error:
                self.fault = f"{name}: {error}"
                raise
            finally:
                source.close()

        thread = threading.Thread(target=guarded, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _pictures(self, source: Any, encoder: H264Encoder, plan: PicturePlan) -> None:
        picture = empty_picture(encoder.width, encoder.height)
        answered = 0
        while not self._ended.is_set():
            stamp = source.read(picture, _TIMEOUT_NS)
            if stamp is None or not self.wanted:
                continue
            if self._keys != answered:
                answered = self._keys
                plan.handle_key_request()
            plan.handle_rate(self.rate.bps)
            coding = plan.handle_picture(self._clock.now_ns())
            if coding is None:
                continue
            unit = encoder.encode(VideoFrame(picture, stamp), coding)
            now_ns = self._clock.now_ns()
            plan.handle_coded(len(unit.data), now_ns)
            self.coded["video"] += 1
            self._hand_over(self._count_and_send, unit)

    def _sound(self, source: Any, encoder: OpusEncoder) -> None:
        while not self._ended.is_set():
            block = source.read(_TIMEOUT_NS)
            if block is None or not self.wanted:
                continue
            opus = encoder.encode(block.samples)
            self.coded["audio"] += 1
            self._hand_over(self._send_opus, opus, heard_stamp(block.stamp))

    def _hand_over(self, send: Callable[..., None], *what: Any) -> None:
        if not self._ended.is_set():
            self._loop.call_soon_threadsafe(send, *what)
