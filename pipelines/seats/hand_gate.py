"""Which inputs of which page move the handle."""

from pipelines.seats.ownership import HandleOwnership
from telepresence.haptics.device.page import PageInput

_SEQUENCES = 1 << 32


class HandGate:
    """Passes the inputs of the page that holds the handle, with numbers of its own.

    Call `poll_release` after each change of the holder: the handle is let go when it changes hands.

    passed, refused: inputs of the holder that were passed, and all others.
    """

    def __init__(self, ownership: HandleOwnership) -> None:
        self.passed = self.refused = 0
        self._ownership = ownership
        self._holder: int | None = None
        self._held = False
        self._newest: int | None = None
        self._sequence = 0

    def handle_input(self, page: int, hand: PageInput) -> PageInput | None:
        """Return what to tell the joystick, or None.

        None: the page does not hold the handle, or the input is not newer than the one before, or
        its place is not from -1 to 1.
        """
        if not self._ownership.may_move(page):
            self.refused += 1
            return None
        if page != self._holder:
            released = self.poll_release(hand.received_ns)
            self._holder, self._newest = page, None
            if released is not None:
                # The next hand begins where this one lets go.
                return released
        newest = self._newest
        ahead = 1 if newest is None else (hand.sequence - newest) % _SEQUENCES
        # A NaN fails the comparisons, too.
        if not (0 < ahead < _SEQUENCES // 2 and -1.0 <= hand.x <= 1.0 and -1.0 <= hand.y <= 1.0):
            self.refused += 1
            return None
        self._newest = hand.sequence
        self._held = hand.dead_man
        self.passed += 1
        return self._numbered(hand)

    def poll_release(self, now_ns: int) -> PageInput | None:
        """Return the input that lets the handle go, once, if its hand is no longer the holder's."""
        if not self._held or (self._holder is not None and self._ownership.may_move(self._holder)):
            return None
        self._held = False
        self._holder = None
        return self._numbered(PageInput(False, 0.0, 0.0, received_ns=now_ns))

    def _numbered(self, hand: PageInput) -> PageInput:
        self._sequence = (self._sequence + 1) % _SEQUENCES
        return hand._replace(sequence=self._sequence)
