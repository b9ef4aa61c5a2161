"""What a receiver hands on: samples, packets and supervision messages, as they came."""

from typing import NamedTuple

from telepresence.link.flows import Flow


class HapticReceived(NamedTuple):
    """One sample from an insert zone."""

    sample: bytes
    now_ns: int


class PacketReceived(NamedTuple):
    """One packet: exactly the UDP payload that entered at the other end of `flow`."""

    flow: Flow
    data: bytes
    now_ns: int


class SupervisionReceived(NamedTuple):
    """One supervision message of twelve octets, which the receiver does not parse."""

    message: bytes
    now_ns: int


LinkEvent = HapticReceived | PacketReceived | SupervisionReceived
