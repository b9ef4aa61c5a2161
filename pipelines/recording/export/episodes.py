"""Rows of a constant rate out of a recording: which picture stands where, and the runs of tasks.

A core. Row i of an episode lies i / fps behind the capture of its first picture.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.recording.channels import RECEIVED, SENT
from pipelines.recording.joined import JoinedMessage
from pipelines.recording.messages import RecordedPacket, unpack
from pipelines.session.topology import TELECOMMAND, TELEMETRY
from telepresence.tmtc.k2aci import Numbered, StartTask, TaskFinished, parse_body
from telepresence.tmtc.pus.node import K2ACI_SERVICE
from telepresence.tmtc.pus.packets import parse_packet


class Placed(NamedTuple):
    """The picture of each row, by its number; -1 before the first.

    own: (rows,), the picture was captured for this row; else it is the one before, repeated.
    left_out: pictures that a newer one of the same row replaced.
    """

    pictures: NDArray[np.int64]
    own: NDArray[np.bool_]
    left_out: int


def row_instants(first_ns: int, end_ns: int, fps: int) -> NDArray[np.int64]:
    """Return the instants of an episode's rows; a row whose instant is after `end_ns` is none."""
    count = max((end_ns - first_ns) * fps // NS_PER_S + 1, 0)
    return first_ns + np.arange(count, dtype=np.int64) * NS_PER_S // fps


def place_pictures(
    captures_ns: NDArray[np.int64], instants_ns: NDArray[np.int64], fps: int
) -> Placed:
    """Each picture stands in the row nearest to its capture. Of several, the newest stays.

    A row without one repeats the picture before it. captures_ns: rising.
    """
    count = len(instants_ns)
    slots = np.rint((captures_ns - instants_ns[0]) * (fps / NS_PER_S)).astype(np.int64)
    pictures = np.full(count, -1, np.int64)
    inside = np.flatnonzero((slots >= 0) & (slots < count))
    # Of several places that are equal, NumPy keeps the last value.
    pictures[slots[inside]] = inside
    own = pictures >= 0
    before = int(np.searchsorted(slots, 0)) - 1
    pictures = np.maximum.accumulate(np.maximum(pictures, before))
    return Placed(pictures, own, len(inside) - int(own.sum()))


def usual_fps(captures_ns: NDArray[np.int64]) -> int:
    """Return the rate of pictures, in whole ones a second, by their median distance."""
    if len(captures_ns) < 2:
        return 1
    return max(round(NS_PER_S / float(np.median(np.diff(captures_ns)))), 1)


class Run(NamedTuple):
    """A run of a task. end_ns: None if the recording ended before."""

    task: str
    begin_ns: int
    end_ns: int | None
    result: str


#: First the channels of the robot, which receives telecommands and sends telemetry.
_STARTS = (f"/{TELECOMMAND}/{RECEIVED}", f"/{TELECOMMAND}/{SENT}")
_ENDS = (f"/{TELEMETRY}/{SENT}", f"/{TELEMETRY}/{RECEIVED}")
#: The channels that `TaskRuns` takes.
TASK_CHANNELS = frozenset((*_STARTS, *_ENDS))


class TaskRuns:
    """Finds the runs of tasks in recorded packets: from `StartTask` to `TaskFinished`.

    At the robot if its packets are in the recording, else at the joystick.
    """

    def __init__(self) -> None:
        self._told: dict[tuple[str, int, str], tuple[int, StartTask | TaskFinished]] = {}

    def handle_message(self, message: JoinedMessage) -> None:
        """Take a packet of `TASK_CHANNELS`. Others than those of tasks are ignored."""
        try:
            recorded = unpack(RecordedPacket, message.data)
            packet = parse_packet(recorded.data)
            body = parse_body(packet.data) if packet.service == K2ACI_SERVICE else None
        except ProtocolError:
            return
        if isinstance(body, Numbered) and isinstance(body.message, StartTask | TaskFinished):
            found = body.message
            # The first one: others are repetitions.
            key = (message.topic, found.run, found.task)
            self._told.setdefault(key, (recorded.session_ns, found))

    def runs(self) -> list[Run]:
        starts, ends = self._of(_STARTS, StartTask), self._of(_ENDS, TaskFinished)
        found = []
        for key, (begin_ns, _) in starts.items():
            end_ns, end = ends.get(key, (None, None))
            result = str(end.result) if isinstance(end, TaskFinished) else "unfinished"
            found.append(Run(key[1], begin_ns, end_ns, result))
        return sorted(found, key=lambda run: run.begin_ns)

    def _of(
        self, channels: Sequence[str], kind: type[StartTask] | type[TaskFinished]
    ) -> dict[tuple[int, str], tuple[int, StartTask | TaskFinished]]:
        for channel in channels:
            found = {
                (run, task): told
                for (topic, run, task), told in self._told.items()
                if topic == channel and isinstance(told[1], kind)
            }
            if found:
                return found
        return {}
