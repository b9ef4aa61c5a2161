"""The process that takes an operator's orders of who drives. `ControlArbiter` decides.

The last order is kept in a file, so that an arbiter or a robot that was killed goes on with it.
"""

from kontur_av.topics.session_files import make_session_root, remember, session_root
from pipelines.hand.hand_topics import (
    ARM_ORDER_TOPIC,
    ARM_SOCKET,
    ARM_STATE_TOPIC,
    AuthorityRequest,
    ControlArbiter,
)
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.requests import RequestServer
from pipelines.session.topic_ends import TopicReader, TopicWriter
from telepresence.haptics.authority import Authority


def run_control_arbiter(context: Context) -> None:
    """Take an operator's orders, and publish who is to drive."""
    now_ns = context.clock.now_ns
    make_session_root(context.session)
    remembered = session_root(context.session) / "owner"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    known = known or Authority.OPERATOR.value
    arbiter = ControlArbiter(Authority(known))
    with (
        context.open_bus() as bus,
        RequestServer(
            context,
            ARM_SOCKET,
            AuthorityRequest,
            lambda request, _: arbiter.handle_request(request, now_ns()),
        ) as server,
    ):
        writer = TopicWriter(bus, ARM_ORDER_TOPIC)
        reader = TopicReader(bus, ARM_STATE_TOPIC)
        while not context.stopping:
            context.tick(now_ns())
            server.serve(TIMEOUT_NS)
            if (state := reader.latest()) is not None:
                arbiter.handle_state(state)
            order = arbiter.order.value
            if order != known:
                known = order
                remember(remembered, order.encode("ascii"))
            # Published repeatedly, for a robot that has started since.
            writer.publish(arbiter.order, now_ns())
