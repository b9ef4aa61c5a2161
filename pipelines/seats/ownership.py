"""Who holds the handle: at most one page, which hands it over, or is gone."""

from typing import NamedTuple


class HandleState(NamedTuple):
    """holder: number of the page that holds the handle. wanted_by: of the page that asks for it."""

    holder: int | None = None
    wanted_by: int | None = None


class HandleOwnership:
    """The pages of a seat by their numbers, and which of them holds the handle.

    Each `handle_` returns "" or one line that says why it was refused. A page that may only watch
    is never joined, so all that it asks is refused. Inputs count only while `may_move` is true.

    state: for the display. `next_event` returns it after each change.
    """

    def __init__(self) -> None:
        self.state = HandleState()
        self._pages: set[int] = set()
        self._shown = self.state

    def handle_joined(self, page: int) -> None:
        """A page that may command is there."""
        self._pages.add(page)

    def handle_gone(self, page: int) -> None:
        """A page is gone; what it held is free at once."""
        self._pages.discard(page)
        holder, wanted_by = self.state
        if page == holder:
            self.state = HandleState()
        elif page == wanted_by:
            self.state = HandleState(holder)

    def handle_take(self, page: int) -> str:
        """The page takes the handle, if it is free."""
        if page not in self._pages:
            return "take: this page may watch only"
        holder = self.state.holder
        if holder == page:
            return ""
        if holder is not None:
            return f"take: page {holder} holds the handle; ask for it"
        self.state = HandleState(page)
        return ""

    def handle_ask(self, page: int) -> str:
        """The page asks the holder for the handle; it takes a free one."""
        holder, wanted_by = self.state
        if page not in self._pages or holder is None or holder == page:
            return self.handle_take(page)
        if wanted_by not in (None, page):
            return f"ask: page {wanted_by} has asked before"
        self.state = HandleState(holder, page)
        return ""

    def handle_give(self, page: int) -> str:
        """The holder gives the handle to the page that asked for it, or frees it."""
        if page != self.state.holder:
            return "give: this page does not hold the handle"
        self.state = HandleState(self.state.wanted_by)
        return ""

    def handle_refuse(self, page: int) -> str:
        """The holder keeps the handle, and the page that asked stops asking."""
        if page != self.state.holder:
            return "refuse: this page does not hold the handle"
        self.state = HandleState(page)
        return ""

    def may_move(self, page: int) -> bool:
        """Whether the inputs of this page count."""
        return page == self.state.holder

    def next_event(self) -> HandleState | None:
        """Return the state if it has changed since the last call, or None."""
        if self._shown == self.state:
            return None
        self._shown = self.state
        return self.state
