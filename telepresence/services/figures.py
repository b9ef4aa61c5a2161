"""What an end of the services counts."""

from dataclasses import dataclass


@dataclass(slots=True, kw_only=True)
class ServiceFigures:
    """TCP services to and from the other end."""

    #: Streams that were opened, by both ends.
    service_streams_opened: int = 0
    #: Streams that ended well.
    service_streams_ended: int = 0
    #: Streams that were cut off: loss of signal, silence, idleness, a broken connection.
    service_streams_reset: int = 0
    #: Connections and streams that this end refused.
    service_streams_refused: int = 0
    #: Octets that were sent, each counted once.
    service_octets_sent: int = 0
    #: Octets that were sent again.
    service_octets_resent: int = 0
    #: Octets that came, each counted once.
    service_octets_received: int = 0
    #: Datagrams that are none of a service.
    service_garbage: int = 0
