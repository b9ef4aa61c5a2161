"""What clients may ask of the session: telecommands, as from a terminal. A core."""

from collections.abc import Sequence
from itertools import count
from typing import Final

from kontur_av.errors import ProtocolError
from pipelines.foxglove.protocol import (
    ServiceCall,
    ServiceRow,
    parse_fields,
    service_failure,
    service_response,
)
from pipelines.mission.choosing import CAMERA, SELECT
from pipelines.mission.tmtc_messages import CommandUpdate, SendCommand
from pipelines.seats.command_desk import CommandDesk
from pipelines.seats.texts import CommandRequest
from pipelines.session.topology import TASKS, Segment, Topology

_WHO: Final = "foxglove"
_SELECT_TASK = "/task/select"
#: By service: the end that sends the telecommand, its application and function, its field.
_COMMANDS = {
    "/camera/select": (Segment.SPACE, CAMERA, SELECT, {"camera": "a camera of the setup"}),
    _SELECT_TASK: (Segment.GROUND, TASKS, "select", {"task": "a task of the catalogue"}),
    "/task/start": (Segment.GROUND, TASKS, "start", {}),
    "/task/abort": (Segment.GROUND, TASKS, "abort", {}),
}


class Services:
    """The services of a session.

    After each `handle_` send `poll_transmit`'s requests, and hand `next_event`'s answers over.

    life: new in each life of the process.
    """

    def __init__(self, topology: Topology, life: int) -> None:
        names = [
            name
            for name, (segment, application, *_) in _COMMANDS.items()
            if segment in topology.segments and (application != TASKS or topology.options.tasks)
        ]
        self.rows: Sequence[ServiceRow] = [
            ServiceRow(number, name, _COMMANDS[name][3]) for number, name in enumerate(names, 1)
        ]
        self.calls = 0
        #: The tasks' names in the catalogue's order.
        self.tasks: Sequence[str] = ()
        self._rows = {row.number: row for row in self.rows}
        self._desks = {
            segment: CommandDesk(f"{_WHO} {life}")
            for segment in {_COMMANDS[name][0] for name in names}
        }
        self._numbers = count(1)
        self._open: dict[int, ServiceCall] = {}

    @property
    def segments(self) -> Sequence[Segment]:
        """The ends whose news it needs."""
        return list(self._desks)

    def handle_call(self, client: int, call: ServiceCall, now_ns: int) -> str:
        """A client that may calls a service. Return why not, or ""; the answer comes later."""
        row = self._rows.get(call.service)
        if row is None:
            return "no such service"
        segment, application, function, _ = _COMMANDS[row.name]
        try:
            fields = parse_fields(row, call)
        except ProtocolError as error:
            return str(error)
        arguments: tuple[str | int, ...] = tuple(fields.values())
        if row.name == _SELECT_TASK:
            if fields["task"] not in self.tasks:
                return f"unknown task: choose one of {', '.join(self.tasks)}"
            arguments = (self.tasks.index(fields["task"]),)
        self.calls += 1
        number = next(self._numbers)
        self._open[number] = call
        asked = CommandRequest(
            request=number, application=application, name=function, arguments=arguments
        )
        self._desks[segment].handle_request(client, asked, _WHO, now_ns)
        return ""

    def handle_update(self, segment: Segment, update: CommandUpdate) -> None:
        """What became of a telecommand of this end."""
        self._desks[segment].handle_update(update)

    def poll_transmit(self, now_ns: int) -> tuple[Segment, SendCommand] | None:
        """Return a request for the TM/TC end of a segment, or None. Ask at least once a second."""
        for segment, desk in self._desks.items():
            if (request := desk.poll_transmit(now_ns)) is not None:
                return segment, request
        return None

    def next_event(self) -> tuple[int, bytes | str] | None:
        """Return the number of a client, which may be gone, and an answer for it; or None."""
        for desk in self._desks.values():
            if (answered := desk.next_event()) is not None:
                call = self._open.pop(answered.request)
                if answered.error:
                    told: bytes | str = service_failure(call.service, call.call, answered.error)
                else:
                    trip_ms = answered.round_trip_ms or 0.0
                    told = service_response(call.service, call.call, trip_ms)
                return answered.page, told
        return None
