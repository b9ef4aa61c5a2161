"""Lets pages join a stream whose last IDR picture is too long ago to replay.

The receiver's decoded picture, in its coded size, becomes an IDR picture of this process alone.
Then come the stream's own parameter sets and its units after that picture. A decoder goes on from
there: the picture is nearly exact at once, and exact after the next refresh wave.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import av

from kontur_av.topics.bus import Lease, TopicBus
from pipelines.page import wire
from pipelines.page.feeds import Feed, Feeds
from pipelines.page.seat_streams import SeatStream
from pipelines.page.unit_history import HistoryUnit, UnitHistory
from pipelines.topology import VideoRow

#: Nearly transparent: the IDR picture costs no octet of the radio.
_QUANTISER = 12


class StartPictures:
    """Makes local IDR pictures for the streams that pages wait for.

    begin: called with a stream's index and the messages with which it begins.
    """

    def __init__(
        self,
        bus: TopicBus,
        streams: Sequence[SeatStream],
        histories: Mapping[int, UnitHistory],
        begin: Callable[[int, list[bytes]], None],
    ) -> None:
        self._bus, self._histories, self._begin = bus, histories, begin
        self._topics = {
            one.index: one.row.decoded_topic
            for one in streams
            if isinstance(one.row, VideoRow) and one.via == "coded"
        }
        self._wanted: dict[int, Feeds] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def want(self, index: int) -> None:
        """A page waits for this stream; nothing happens if one is on its way already."""
        topic = self._topics.get(index)
        if topic is None or index in self._wanted or not self._histories[index].parameter_sets:
            return

        def handle(lease: Lease) -> None:
            timestamp = lease.stamp.rtp_timestamp
            if timestamp is None or index not in self._wanted or index in self._busy():
                return
            picture = lease.octets()
            task = asyncio.create_task(
                self._make(index, picture, lease.width, lease.height, timestamp), name=str(index)
            )
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        self._wanted[index] = Feeds(
            self._bus, [Feed(topic=topic, handle=handle, depth=1, newest=True)]
        )

    def close(self) -> None:
        """Leave the topics."""
        for feeds in self._wanted.values():
            feeds.close()
        self._wanted.clear()

    def _busy(self) -> set[int]:
        return {int(task.get_name()) for task in self._tasks}

    async def _make(
        self, index: int, picture: bytes, width: int, height: int, timestamp: int
    ) -> None:
        loop = asyncio.get_running_loop()
        data = await loop.run_in_executor(None, idr_of, picture, width, height)
        history = self._histories[index]
        # The unit itself may come a moment after its picture.
        for _ in range(20):
            following = history.after(timestamp)
            if following is not None:
                break
            await asyncio.sleep(0.01)
        feeds = self._wanted.pop(index, None)
        if feeds is None:
            return
        feeds.close()
        if following is None:
            self.want(index)
            return
        self._begin(index, start_messages(index, data, history.parameter_sets, following))


def start_messages(
    index: int, idr: bytes, parameter_sets: bytes, following: Sequence[HistoryUnit]
) -> list[bytes]:
    """Return the messages with which a page begins at a local IDR picture."""
    begin = wire.pack_unit(index, idr, flags=wire.KEY | wire.REPLAYED, sequence=0, capture_ns=None)
    messages = [begin]
    for number, one in enumerate(following):
        unit = one.unit
        if number == 0:
            unit = replace(unit, data=parameter_sets + unit.data)
        newest = number == len(following) - 1
        flags = wire.DAMAGED * unit.damaged | (0 if newest else wire.REPLAYED)
        messages.append(
            wire.pack_unit(
                index, unit.data, flags=flags, sequence=one.sequence, capture_ns=one.capture_ns
            )
        )
    return messages


def idr_of(picture: bytes, width: int, height: int) -> bytes:
    """Return an I420 picture as one IDR access unit, Annex B."""
    import numpy as np

    context = av.CodecContext.create("libx264", "w")
    assert isinstance(context, av.VideoCodecContext)
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.options = {
        "preset": "veryfast",
        "tune": "zerolatency",
        "qp": str(_QUANTISER),
        "x264-params": "annexb=1:repeat-headers=1:ref=1:bframes=0",
    }
    planes = np.frombuffer(picture, np.uint8).reshape(height * 3 // 2, width)
    frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
    return b"".join(bytes(packet) for packet in (*context.encode(frame), *context.encode(None)))
