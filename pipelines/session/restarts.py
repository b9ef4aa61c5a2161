"""When a process that has ended is started again. A core: the launcher tells it the time."""

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.topology import Stage

#: The pause before a restart. It doubles while a process keeps ending early, up to the longest.
FIRST_PAUSE_NS = 50 * NS_PER_MS
LONGEST_PAUSE_NS = NS_PER_S
#: After a life this long, the pauses begin anew.
GOOD_LIFE_NS = 5 * NS_PER_S
#: A restarted sender does not know what its predecessor sent. So that the cap holds over any
#: second, no second may contain both. The 10 ms are the guard of `Budget`.
SENDER_REST_NS = NS_PER_S + 10 * NS_PER_MS
#: Why the kernel sends SIGBUS to a process of a session.
NO_ROOM = "SIGBUS, because shared memory is full"


def lacks_room(last_error: str) -> bool:
    """Whether a process ended because shared memory was full."""
    return "shared memory is full" in last_error


class RestartPolicy:
    """The pauses between the lives of one process.

    Call `handle_start` for each life, and `handle_end` or `handle_stop` at its end. Start the next
    one when `poll_timeout` says.
    """

    def __init__(self, stage: Stage) -> None:
        self._rest_ns = SENDER_REST_NS if stage is Stage.SENDER else 0
        self._pause_ns = FIRST_PAUSE_NS
        self._started_ns: int | None = None
        self._due_ns: int | None = None

    def handle_start(self, now_ns: int) -> None:
        self._started_ns, self._due_ns = now_ns, None

    def handle_end(self, now_ns: int) -> None:
        assert self._started_ns is not None
        if now_ns - self._started_ns >= GOOD_LIFE_NS:
            self._pause_ns = FIRST_PAUSE_NS
        self._due_ns = now_ns + max(self._pause_ns, self._rest_ns)
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)

    def handle_stop(self, now_ns: int) -> None:
        """The present life has ended because that was asked for."""
        self._pause_ns = FIRST_PAUSE_NS
        self._due_ns = now_ns + self._rest_ns

    def poll_timeout(self) -> int | None:
        """Return when to start the next life; None during a life and before the first."""
        return self._due_ns
