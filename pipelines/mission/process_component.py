"""The process of a user's component in telemetry. `ComponentDesk` decides.

The component's methods may block. What telecommands have set outlives the process.
"""

import msgspec

from kontur_av.topics.session_files import remember, session_root
from pipelines.mission.component_desk import ComponentDesk
from pipelines.mission.tmtc_messages import Values, unpack_news
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.topology import TMTC_TOPICS, Segment, component_process
from telepresence.tmtc.telemetry_source import Component, load_telemetry

_DEPTH = 32


def run_component(context: Context, component: Component) -> None:
    """Read the component, and carry out by it what telecommands ask for."""
    clock, table = context.clock, component.application
    remembered = session_root(context.session) / component_process(table.name)
    known: Values = {}
    if remembered.exists():
        known = msgspec.json.decode(remembered.read_bytes(), type=Values)
    source = load_telemetry(component.spec)
    source.configure()
    with context.open_bus() as bus:
        reader = bus.reader(TMTC_TOPICS[Segment.GROUND], depth=_DEPTH)
        now_ns = clock.now_ns()
        client = f"{table.name} {now_ns}"
        desk = ComponentDesk(source, table, now_ns=now_ns, client=client, settings=known)
        context.on_flush(lambda: desk.tell(context.probe))
        waiter = bus.waiter([reader])
        while not context.stopping:
            context.tick(clock.now_ns())
            while (octets := reader.next_octets()) is not None:
                desk.handle_news(unpack_news(octets), clock.now_ns())
            desk.handle_time(clock.now_ns())
            if desk.settings != known:
                known = desk.settings
                remember(remembered, msgspec.json.encode(known))
            now_ns = clock.now_ns()
            while (request := desk.poll_transmit(now_ns)) is not None:
                if not send_to_tmtc(context.session, Segment.GROUND, request):
                    break
                desk.handle_sent(request, now_ns)
            waiter.wait(max(0, min(PATIENCE_NS, desk.poll_timeout() - now_ns)))
        del waiter
    source.close()
