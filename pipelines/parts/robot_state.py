"""The robot's state as it lies in shared memory, for whoever draws or sounds the world."""

import struct

from kontur_av.topics import TopicBus
from pipelines.names import ROBOT_TOPIC
from telepresence.world import StateAt, WorldState, scripted_state

#: Instant, x, y (m), force (N), contact, instant at which the contact began.
_LAYOUT = struct.Struct("=qddd?q")
STATE_OCTETS = _LAYOUT.size


def pack_state(state: WorldState) -> bytes:
    """A state as octets; a contact without a beginning begins now."""
    since_ns = state.time_ns if state.contact_since_ns is None else state.contact_since_ns
    return _LAYOUT.pack(state.time_ns, state.x_m, state.y_m, state.force_n, state.contact, since_ns)


def unpack_state(data: bytes) -> WorldState:
    """What `pack_state` packed."""
    time_ns, x_m, y_m, force_n, contact, since_ns = _LAYOUT.unpack(data)
    return WorldState(time_ns, x_m, y_m, force_n, contact, since_ns if contact else None)


def newest_state(bus: TopicBus) -> StateAt:
    """The robot's newest state; as long as there never was a robot, the scripted motion."""
    reader = bus.reader(ROBOT_TOPIC)
    known: WorldState | None = None

    def state_at(now_ns: int) -> WorldState:
        nonlocal known
        lease = reader.latest()
        if lease is not None:
            with lease:
                known = unpack_state(lease.octets())
        return scripted_state(now_ns) if known is None else known

    return state_at
