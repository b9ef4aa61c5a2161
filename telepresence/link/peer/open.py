"""The path without protection, for a private network: whose frames are followed. A core.

An end that was given its peer's address takes frames from there only. An end that waits to be
called follows the source of good frames, and another one only when the present peer has been silent
for `SILENCE_NS`. All other datagrams are a stranger's.
"""

from kontur_av.clock import NS_PER_S
from telepresence.link.frame import FrameCodec
from telepresence.link.peer.figures import Address, PeerFigures, PeerHistory, address_text
from telepresence.link.profile import LinkProfile

SILENCE_NS = NS_PER_S


class OpenPath:
    """See the module for whose frames are followed.

    receive: the profile of the way in. address: where the peer is; None: it calls.
    """

    def __init__(self, receive: LinkProfile, *, address: Address | None, now_ns: int) -> None:
        self._codec = FrameCodec(receive)
        self._octets = receive.frame_octets
        self._fixed = address is not None
        self._address = address
        self._heard_ns = now_ns
        self._history = PeerHistory(now_ns)
        self._history.add("the path is NOT PROTECTED", now_ns)
        self._session_ns: int | None = None if address is None else 0
        self._moves = self._sent = self._unsent = self._taken = self._strangers = 0

    def handle_datagram(self, datagram: bytes, source: Address, now_ns: int) -> bytes | None:
        """Return the peer's frame, good or not; None for a stranger's datagram."""
        if source != self._address and not self._follow(datagram, source, now_ns):
            self._strangers += 1
            return None
        # The radio may have hit some of its bits, so the peer is not silent.
        if len(datagram) == self._octets:
            self._heard_ns = now_ns
        self._taken += 1
        return datagram

    def seal(self, frame: bytes, now_ns: int) -> tuple[bytes, Address] | None:
        """Return the frame and where it goes; None as long as nobody has called."""
        if self._address is None:
            self._unsent += 1
            return None
        self._sent += 1
        return frame, self._address

    def handle_rest(self, now_ns: int, until_ns: int) -> bool:
        """There is nothing to do in the rest of a slot."""
        return False

    def poll_transmit(self) -> tuple[bytes, Address] | None:
        """There are no datagrams but those of frames."""
        return None

    def report(self, now_ns: int) -> PeerFigures:
        """What this end knows of the path until `now_ns`."""
        return PeerFigures(
            begun_ns=self._history.begun_ns,
            protected=False,
            address=None if self._address is None else address_text(self._address),
            session_ns=self._session_ns,
            address_changes=self._moves,
            sent=self._sent,
            unsent=self._unsent,
            taken=self._taken,
            dropped={"stranger": self._strangers} if self._strangers else {},
            events=self._history.events(),
        )

    def _follow(self, datagram: bytes, source: Address, now_ns: int) -> bool:
        """Follow another source if it may be the peer; whether it is followed."""
        found = self._address is not None
        if self._fixed or (found and now_ns - self._heard_ns < SILENCE_NS):
            return False
        if isinstance(self._codec.parse(datagram), str):
            return False
        self._moves += found
        if self._session_ns is None:
            self._session_ns = now_ns - self._history.begun_ns
        word = "moved to" if found else "found at"
        self._history.add(f"peer {word} {address_text(source)}", now_ns)
        self._address = source
        return True
