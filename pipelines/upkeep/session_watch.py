"""What maintenance must know of a running session: whether there is contact, and an experiment."""

from kontur_av.closing import Closing
from kontur_av.topics.bus import Reader, TopicBus
from pipelines.link.figures import unpack_link
from pipelines.mission.tmtc_socket import tmtc_socket_name
from pipelines.session.asking import running_sessions
from pipelines.session.mission_messages import ExperimentShown, unpack
from pipelines.session.setup.segments import Segment
from pipelines.session.topology import MISSION_GROUND_TOPIC, link_state_topic
from telepresence.tasks.experiment import Phase

_PATIENCE_NS = 2_000_000_000


class SessionWatch(Closing):
    """Contact and experiment of a session on this machine.

    name: of the session. Raises ConfigError if there is none.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._bus = TopicBus.join(name)
        topics = self._bus.topics()
        self._experiment = (
            self._bus.reader(MISSION_GROUND_TOPIC) if MISSION_GROUND_TOPIC in topics else None
        )
        self._links = [
            self._bus.reader(topic)
            for segment in Segment
            if (topic := link_state_topic(segment)) in topics
        ]
        self._shown: ExperimentShown | None = None
        self._signal = False

    def runs(self) -> bool:
        """Whether the session still runs."""
        return any(self.name in running_sessions(tmtc_socket_name(end)) for end in Segment)

    def contact(self) -> bool:
        """Whether the gateway here has a signal."""
        for reader in self._links:
            octets = _newest(reader, wait=False)
            if octets is not None:
                self._signal = bool(unpack_link(octets).get("signal"))
        return self._signal

    def experiment(self) -> str:
        """What runs, such as "aiming, run 3"; empty if nothing does."""
        if self._experiment is not None:
            octets = _newest(self._experiment, wait=self._shown is None)
            if octets is not None:
                self._shown = unpack(ExperimentShown, octets)
        shown = self._shown
        if shown is None or shown.phase == Phase.IDLE:
            return ""
        return f"{shown.task}, run {shown.run}"

    def close(self) -> None:
        """Leave the session."""
        self._bus.close()


def _newest(reader: Reader, *, wait: bool) -> bytes | None:
    octets = reader.latest_octets()
    if octets is None and wait:
        reader.wait(_PATIENCE_NS)
        octets = reader.latest_octets()
    return octets
