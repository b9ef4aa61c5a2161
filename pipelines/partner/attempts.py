"""When to connect to a partner or a media server, and when to try again. A core."""

from enum import Enum

from kontur_av.clock import NS_PER_MS, NS_PER_S

_FIRST_NS = 500 * NS_PER_MS
_LONGEST_NS = 30 * NS_PER_S
#: A connection that lasted so long was good: the next attempt comes soon.
_GOOD_NS = 10 * NS_PER_S
#: A restart of ICE that brings nothing for so long is given up for a new connection.
_RESTART_NS = 8 * NS_PER_S


class Doing(Enum):
    """What the connection does."""

    WAITING = "waiting"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    RESTARTING = "restarting ICE"


class Attempts:
    """Decides when to connect, to restart ICE, and to begin anew.

    1. At `poll_timeout` call `poll_connect`; if it returns True, begin a connection.
    2. Tell `handle_connected` or `handle_ended`.
    3. While connected, call `poll_restart` with whether the partner is silent. If it returns True,
       restart ICE. If `is_hopeless`, end the connection.
    """

    def __init__(self) -> None:
        self.doing = Doing.WAITING
        self._due_ns = 0
        self._wait_ns = _FIRST_NS
        self._since_ns = 0
        #: Connections begun, those that stood, restarts of ICE.
        self.begun = self.stood = self.restarts = 0

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_connect`; None while there is a connection."""
        return self._due_ns if self.doing is Doing.WAITING else None

    def poll_connect(self, now_ns: int) -> bool:
        """Return whether to begin a connection now."""
        if self.doing is not Doing.WAITING or now_ns < self._due_ns:
            return False
        self.doing = Doing.CONNECTING
        self.begun += 1
        return True

    def handle_connected(self, now_ns: int) -> None:
        """The connection stands, or stands again."""
        if self.doing is Doing.CONNECTING:
            self.stood += 1
            self._since_ns = now_ns
        self.doing = Doing.CONNECTED

    def handle_ended(self, now_ns: int) -> None:
        """The connection has ended, or could not be made. The next one waits ever longer."""
        stood = self.doing in (Doing.CONNECTED, Doing.RESTARTING)
        if stood and now_ns - self._since_ns >= _GOOD_NS:
            self._wait_ns = _FIRST_NS
        self.doing = Doing.WAITING
        self._due_ns = now_ns + self._wait_ns
        self._wait_ns = min(self._wait_ns * 2, _LONGEST_NS)

    def poll_restart(self, *, silent: bool, now_ns: int) -> bool:
        """Return whether to restart ICE now. silent: nothing comes from the partner."""
        if self.doing is Doing.RESTARTING and not silent:
            self.doing = Doing.CONNECTED
        if self.doing is not Doing.CONNECTED or not silent:
            return False
        self.doing = Doing.RESTARTING
        self.restarts += 1
        self._restarted_ns = now_ns
        return True

    def is_hopeless(self, now_ns: int) -> bool:
        """Return whether a restart of ICE has brought nothing for too long."""
        return self.doing is Doing.RESTARTING and now_ns - self._restarted_ns > _RESTART_NS

    _restarted_ns = 0
