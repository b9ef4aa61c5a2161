"""Does what a seat decides: topics, recorder, launcher and the TM/TC end get it."""

import asyncio
import os
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import (
    INPUT_OCTETS,
    REQUEST_OCTETS,
    HandRequest,
    pack_input,
    pack_request,
)
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.seats.own_inputs import Given
from pipelines.seats.seat import RecordingAsked, Seat
from pipelines.session.process import Context
from pipelines.session.recorder_control import recorder_path
from pipelines.session.recorder_requests import (
    MAX_LINE_OCTETS,
    START,
    STOP,
    RecordAnswer,
    RecordingWish,
    RecordRequest,
    pack_line,
    parse_record_answer,
)
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.session_switch import Order
from pipelines.session.topology import HAND_INPUT_TOPIC, HAND_REQUEST_TOPIC, Segment
from telepresence.haptics.device.page import PageInput


class SeatDeeds:
    """What a seat's process does to others. settle: called when the seat was told an answer."""

    def __init__(
        self,
        seat: Seat,
        context: Context,
        serving: ServingLoop,
        bus: TopicBus,
        settle: Callable[[], None],
    ) -> None:
        self._seat, self._context, self._serving, self._settle = seat, context, serving, settle
        self._now_ns = context.clock.now_ns
        self._numbers = count()
        self._hand = self._commands = None
        if seat.plan.segment is Segment.SPACE:
            self._hand = bus.writer(HAND_INPUT_TOPIC, max_octets=INPUT_OCTETS, wake=False)
            self._commands = bus.writer(HAND_REQUEST_TOPIC, max_octets=REQUEST_OCTETS, wake=False)
        self._own = {
            each.index: bus.writer(
                each.topic,
                max_octets=each.size[0] * each.size[1] * 3 // 2 if each.size else 2 * 960,
            )
            for each in seat.plan.inputs
        }

    def do(self) -> None:
        while (event := self._seat.next_event()) is not None:
            match event:
                case PageInput():
                    if self._hand is not None:
                        stamp = CaptureStamp(event.received_ns, event.sequence, "page")
                        self._hand.publish_octets(pack_input(event), stamp)
                case HandRequest():
                    if self._commands is not None:
                        stamp = CaptureStamp(self._now_ns(), next(self._numbers), "page")
                        self._commands.publish_octets(pack_request(event), stamp)
                case Order():
                    self._context.order(event, self._now_ns())
                case RecordingAsked():
                    self._serving.begin(self._record(event))
                case _:
                    # One that is not taken now is repeated.
                    send_to_tmtc(self._context.session, self._seat.plan.segment, event)

    def publish(self, given: Given) -> None:
        """Publish what a page's own camera or microphone gives."""
        writer, size = self._own[given.input.index], given.input.size
        if size is None:
            writer.publish_octets(bytes(given.data), given.stamp)
            return
        loan = writer.loan_picture(*size)
        loan.payload[:] = np.frombuffer(given.data, np.uint8)
        loan.publish(given.stamp)

    async def _record(self, asked: RecordingAsked) -> None:
        error = await ask_recorder(self._context.session, begin=asked.begin)
        self._seat.handle_recorder(asked, error)
        self._settle()


#: A recorder that ends writes a slow disk's file to its end first.
_PATIENCE_S = 15.0


async def ask_recorder(session: str, *, begin: bool) -> str:
    """Begin or end the recording of `session`; return "", or in words why it does not.

    The file is in the directory in which the session was started. It is called after the session
    and the time, in UTC.
    """
    request = RecordRequest(record=STOP)
    if begin:
        instant = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        path = Path.cwd() / f"{session}-{instant}.mcap"
        wish = RecordingWish(file=os.fspath(path), command="the page of ground control")
        request = RecordRequest(record=START, wish=wish)
    try:
        reader, writer = await asyncio.open_unix_connection(
            os.fspath(recorder_path(session)), limit=MAX_LINE_OCTETS
        )
    except OSError:
        return "the session's recorder is not running"
    try:
        writer.write(pack_line(request))
        answer = await _answer(reader)
    finally:
        writer.close()
    if answer is None:
        return "the session's recorder has ended before it answered"
    return "" if answer.ok else answer.error


async def _answer(reader: asyncio.StreamReader) -> RecordAnswer | None:
    try:
        async with asyncio.timeout(_PATIENCE_S):
            return parse_record_answer(await reader.readline())
    except (OSError, ValueError, TimeoutError):
        return None
