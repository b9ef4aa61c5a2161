"""Shared memory: publish once, for any number of readers."""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from kontur_av.topics.bus import Lease, Loan, Reader, TopicBus, Writer
    from kontur_av.topics.session_files import remove_session

__all__ = [
    "Lease",
    "Loan",
    "Reader",
    "TopicBus",
    "Writer",
    "remove_session",
]

__getattr__, __dir__ = lazy_names(__name__)
