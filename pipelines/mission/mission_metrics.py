"""What telecommands, telemetry and tasks count."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.metrics import Most
from pipelines.session.session_metrics import DatedEvent
from pipelines.session.task_journal import TaskRow


@dataclass(frozen=True, slots=True, kw_only=True)
class TmtcMetrics:
    """PUS and K2ACI at one end: the console's in space, the selector's on the ground."""

    #: Packets given to the radio.
    pus_sent: int = 0
    #: Their octets.
    pus_sent_octets: int = 0
    #: Packets that came by radio.
    pus_received: int = 0
    #: Unreadable packets and requests.
    pus_garbage: int = 0
    #: Reports and messages that nothing here waits for, or of an earlier start.
    pus_unexpected: int = 0
    #: Packets that waited for the token bucket.
    pus_delayed: int = 0
    #: Reports and news dropped: too many waited.
    pus_dropped: int = 0
    #: Telecommands sent, with repetitions.
    pus_telecommands: int = 0
    #: Telecommands sent again.
    pus_telecommands_repeated: int = 0
    #: Telecommands carried out here.
    pus_executed: int = 0
    #: Telecommands that failed here.
    pus_failed: int = 0
    #: Telecommands that came again.
    pus_duplicates: int = 0
    #: Events reported.
    pus_events: int = 0
    #: Housekeeping reports sent.
    pus_housekeeping: int = 0
    #: Reports of applications received.
    pus_reports: int = 0
    #: Messages of K2ACI sent, with repetitions.
    k2aci_sent: int = 0
    #: Messages of K2ACI sent again.
    k2aci_repeated: int = 0
    #: Messages of K2ACI received.
    k2aci_arrived: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SituationMetrics:
    """What an end says at a terminal of its machine, as `pipelines.session.situation` has it."""

    #: What keeps the hand from moving the robot; `follows` and `ready`: nothing does.
    situation: str = ""
    #: The same as a part of a sentence.
    reason: str = ""
    #: What to do next.
    advice: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskMetrics:
    """The process of tasks, and the newest runs."""

    #: Runs whose file could not be written.
    unrecorded: int = 0
    #: Why the newest of them has none.
    unrecorded_why: str | None = None
    #: The runs, by their numbers.
    runs: Mapping[int, TaskRow] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentMetrics:
    """A user's component in telemetry."""

    #: Functions that it called after events.
    actions: int = 0
    #: Of these, failed.
    actions_failed: int = 0
    #: Functions and events beyond the rate.
    actions_dropped: int = 0
    events_dropped: int = 0
    #: Exceptions and unfit values.
    faults: int = 0
    #: The newest of them.
    fault: str = ""
    #: Requests dropped: too many waited.
    requests_dropped: int = 0
    #: The longest that one waited.
    requests_waited_ms: Most[float] = 0.0
    #: Events and faults; the newest 200.
    events: tuple[DatedEvent, ...] = ()
