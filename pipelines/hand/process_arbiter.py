"""The process that takes an operator's orders of who drives. `ControlArbiter` decides.

The last order is kept in a file, so that an arbiter or a robot that was killed goes on with it.
"""

from kontur_av.topics.session_files import make_session_root, remember, session_root
from pipelines.hand.hand_topics import (
    ARM_ORDER_OCTETS,
    ARM_SOCKET,
    ArmState,
    AuthorityRequest,
    ControlArbiter,
)
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.requests import RequestServer
from pipelines.session.topic_ends import NumberedTopic
from pipelines.session.topology import ARM_ORDER_TOPIC, ARM_STATE_TOPIC
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
        writer = NumberedTopic(bus, ARM_ORDER_TOPIC, max_octets=ARM_ORDER_OCTETS)
        reader = bus.reader(ARM_STATE_TOPIC)
        while not context.stopping:
            context.tick(now_ns())
            server.serve(TIMEOUT_NS)
            if (state := reader.latest_octets()) is not None:
                arbiter.handle_state(ArmState.unpack(state))
            order = arbiter.order.value
            if order != known:
                known = order
                remember(remembered, order.encode("ascii"))
            # Published repeatedly, for a robot that has started since.
            writer.publish_octets(order.encode("ascii"), now_ns())
