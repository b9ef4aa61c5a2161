"""The process of `--metrics`: `/metrics` for Prometheus, and `/healthz`."""

import asyncio
from collections.abc import Sequence
from http import HTTPStatus

import msgspec
from aiohttp import web
from prometheus_client import CONTENT_TYPE_LATEST

from kontur_av.clock import NS_PER_S
from pipelines.report.exposition import Exposition
from pipelines.session.process import Context
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.topology.topics import METRICS
from pipelines.session.web_site import SHUTDOWN_S, ConnectionGate, quiet_log

#: The launcher tells the figures once a second.
_LATE_NS = 10 * NS_PER_S


def run_metrics(context: Context) -> None:
    """Serve on the socket that the launcher has bound."""
    asyncio.run(_MetricsServer(context).run())


class _MetricsServer:
    def __init__(self, context: Context) -> None:
        self._context, self._now_ns = context, context.clock.now_ns
        self._exposition = Exposition()
        self._told_ns: int | None = None

    async def run(self) -> None:
        serving = ServingLoop(self._context, lambda now_ns: None)
        if self._context.link is not None:
            serving.loop.add_reader(self._context.link.fileno(), self._take)
        server = web.Server(self._handle, access_log=None, logger=quiet_log("pipelines.report"))
        runner = web.ServerRunner(server, shutdown_timeout=SHUTDOWN_S)
        await runner.setup()
        self._gate = ConnectionGate(self._context.pages[METRICS], server, None)
        self._gate.start()
        try:
            await serving.run()
        finally:
            self._gate.close()
            await runner.cleanup()

    def _take(self) -> None:
        while (news := self._context.receive_news()) is not None:
            self._exposition.report = msgspec.json.decode(news.report)
            self._exposition.problems = news.problems
            self._told_ns = self._now_ns()

    async def _handle(self, request: web.BaseRequest) -> web.Response:
        if request.method not in ("GET", "HEAD"):
            return web.Response(status=HTTPStatus.METHOD_NOT_ALLOWED, headers={"Allow": "GET"})
        self._gate.handle_known(request.transport, watches=True)
        if request.path == "/metrics":
            headers = {"Content-Type": CONTENT_TYPE_LATEST}
            return web.Response(body=self._exposition.text(), headers=headers)
        if request.path == "/healthz":
            problems = self._problems()
            status = HTTPStatus.SERVICE_UNAVAILABLE if problems else HTTPStatus.OK
            return web.Response(status=status, text="\n".join(problems or ["well"]) + "\n")
        return web.Response(status=HTTPStatus.NOT_FOUND, text="/metrics or /healthz\n")

    def _problems(self) -> Sequence[str]:
        told_ns = self._told_ns
        if told_ns is None or self._now_ns() - told_ns > _LATE_NS:
            return ["the session does not tell its figures"]
        return self._exposition.problems
