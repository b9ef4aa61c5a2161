"""What an end of the file transfer counts."""

from dataclasses import dataclass


@dataclass(slots=True, kw_only=True)
class FileFigures:
    """Files to and from the other end."""

    #: Octets of files that were sent, each counted once.
    file_octets_sent: int = 0
    #: Octets that were sent again, because the other end had not got them.
    file_octets_resent: int = 0
    #: Octets of files that came, each counted once.
    file_octets_received: int = 0
    #: Octets that came more than once.
    file_octets_repeated: int = 0
    #: Transactions that ended well, of both ends.
    file_transactions_finished: int = 0
    #: Transactions that failed, of both ends.
    file_transactions_failed: int = 0
    #: What this end refused: names, jobs of its directory, too many at once.
    file_requests_refused: int = 0
    #: Malformed datagrams.
    file_garbage: int = 0
    #: How long transactions waited for contact.
    file_suspended_ns: int = 0
