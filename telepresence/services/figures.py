"""What an end of the services counts."""

from dataclasses import dataclass


@dataclass(slots=True, kw_only=True)
class ServiceFigures:
    """TCP services to and from the other end."""

    #: Streams opened, by both ends.
    service_streams_opened: int = 0
    #: Streams that ended well.
    service_streams_ended: int = 0
    #: Streams cut off.
    service_streams_reset: int = 0
    #: Connections and streams refused here.
    service_streams_refused: int = 0
    #: Octets sent, each counted once.
    service_octets_sent: int = 0
    #: Octets sent again.
    service_octets_resent: int = 0
    #: Octets received, each counted once.
    service_octets_received: int = 0
    #: Malformed datagrams.
    service_garbage: int = 0
