"""The process of the gateway application's desk. `ControlArbiter` decides.

The last order is kept in a file, so that a desk or a robot that was killed goes on with it.
"""

from kontur_av.topics.session_files import make_session_root, remember, session_root
from pipelines.hand.hand_topics import ARM_ORDER_TOPIC, ARM_SOCKET, ARM_STATE_TOPIC, ControlArbiter
from pipelines.session.process import Context
from pipelines.session.terminals import serve_terminals
from pipelines.session.topic_ends import TopicReader, TopicWriter
from telepresence.haptics.authority import Authority


def run_control_arbiter(context: Context) -> None:
    """Take an operator's orders, and publish who is to drive."""
    make_session_root(context.session)
    remembered = session_root(context.session) / "owner"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    known = known or Authority.OPERATOR.value
    service = ControlArbiter(Authority(known))
    with context.open_bus() as bus:
        writer = TopicWriter(bus, ARM_ORDER_TOPIC)
        reader = TopicReader(bus, ARM_STATE_TOPIC)

        def follow(now_ns: int) -> None:
            nonlocal known
            if (state := reader.latest()) is not None:
                service.handle_state(state)
            order = service.order.value
            if order != known:
                known = order
                remember(remembered, order.encode("ascii"))
            # Published repeatedly, for a robot that has started since.
            writer.publish(service.order, now_ns)

        serve_terminals(context, ARM_SOCKET, service.service, follow)
