"""The process that serves a segment's browser pages."""

import asyncio

from pipelines.page.server import PageServer
from pipelines.runtime.process import Context
from pipelines.topology import Segment


def run_page(context: Context, *, segment: Segment) -> None:
    """Serve the pages of `segment` on the socket that the launcher has bound."""
    asyncio.run(_serve(context, segment))


async def _serve(context: Context, segment: Segment) -> None:
    with context.open_bus() as bus:
        await PageServer(context, segment, bus).run()
