"""The robot's state in shared memory, from which scenes draw pictures and make sounds."""

import struct
from dataclasses import replace

from kontur_av.topics.bus import TopicBus
from pipelines.session.mission_messages import LedsShown, unpack
from pipelines.session.topology import MISSION_LEDS_TOPIC, ROBOT_TOPIC
from telepresence.tasks.places import lights_of
from telepresence.world import StateAt, WorldState, scripted_state
from telepresence.world.state import Lights

#: Instant, x, y (m), force (N), contact, instants at which this contact and the newest one began,
#: and whether the hand holds a ball.
_LAYOUT = struct.Struct("=qddd?qq?")
STATE_OCTETS = _LAYOUT.size
#: No contact yet.
_NEVER_NS = -(1 << 63)


def pack_state(state: WorldState) -> bytes:
    """Pack a state; a contact without a beginning begins now."""
    since_ns = state.time_ns if state.contact_since_ns is None else state.contact_since_ns
    touched_ns = state.touched_ns
    if touched_ns is None:
        touched_ns = since_ns if state.contact else _NEVER_NS
    place = state.x_m, state.y_m, state.force_n, state.contact
    return _LAYOUT.pack(state.time_ns, *place, since_ns, touched_ns, state.holds)


def unpack_state(data: bytes) -> WorldState:
    time_ns, x_m, y_m, force_n, contact, since_ns, touched_ns, holds = _LAYOUT.unpack(data)
    return WorldState(
        time_ns,
        x_m,
        y_m,
        force_n,
        contact,
        since_ns if contact else None,
        None if touched_ns == _NEVER_NS else touched_ns,
        holds=holds,
    )


def newest_state(bus: TopicBus, *, leds: bool = False) -> StateAt:
    """Return a function from an instant to the robot's state; without a robot, scripted motion.

    leds: the state has what the LED panel shows, too.
    """
    reader = bus.reader(ROBOT_TOPIC)
    shown = bus.reader(MISSION_LEDS_TOPIC) if leds else None
    known: WorldState | None = None
    lights = Lights()

    def state_at(now_ns: int) -> WorldState:
        nonlocal known, lights
        if (octets := reader.latest_octets()) is not None:
            known = unpack_state(octets)
        state = scripted_state(now_ns) if known is None else known.at(now_ns)
        if shown is None:
            return state
        if (octets := shown.latest_octets()) is not None:
            lights = lights_of(unpack(LedsShown, octets).picture)
        return replace(state, lights=lights)

    return state_at
