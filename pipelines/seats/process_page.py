"""The process that serves a segment's browser pages."""

import asyncio

from pipelines.seats.server import PageServer
from pipelines.session.process import Context
from pipelines.session.topology import Segment
from telepresence.tasks.definitions import Catalogue


def run_page(context: Context, *, segment: Segment, tasks: Catalogue | None = None) -> None:
    """Serve the pages of `segment` on the socket that the launcher has bound.

    tasks: those of the session, for the panel.
    """
    asyncio.run(_serve(context, segment, tasks))


async def _serve(context: Context, segment: Segment, tasks: Catalogue | None) -> None:
    with context.open_bus() as bus:
        await PageServer(context, segment, bus, tasks).run()
