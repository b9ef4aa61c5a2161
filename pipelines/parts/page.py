"""The process that serves a segment's browser pages."""

import aiohttp  # noqa: F401  # loaded once, before the forks

from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.topology import Segment


def run_page(context: Context, *, segment: Segment) -> None:
    """Serve the pages of `segment` on the socket that the launcher has bound."""
    clock = context.clock
    while not context.stopping:
        now_ns = clock.now_ns()
        context.tick(now_ns)
        clock.sleep_until_ns(now_ns + PATIENCE_NS)
