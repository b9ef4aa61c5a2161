"""The process that serves a segment's browser pages; `pipelines.page` has what it does."""

import asyncio

# Loaded once, before the forks.
from kontur_av.topics.bus import TopicBus
from pipelines.page.server import PageServer
from pipelines.runtime.process import Context
from pipelines.topology import Segment


def run_page(context: Context, *, segment: Segment) -> None:
    """Serve the pages of `segment` on the socket that the launcher has bound."""
    with context.open_bus() as bus:
        asyncio.run(_serve(context, segment, bus))


async def _serve(context: Context, segment: Segment, bus: TopicBus) -> None:
    await PageServer(context, segment, bus).run()
