"""The option of a session's figures for a monitoring system."""

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec

from kontur_av.errors import ConfigError
from pipelines.commands.common import output_that_may_fail
from pipelines.commands.page_options import parse_page
from pipelines.session.page_sockets import PageListener, bind_pages, listeners
from pipelines.session.topology import METRICS

_PORT = "9270"


def add_metrics_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--metrics",
        metavar="[HOST:]PORT",
        nargs="?",
        const=_PORT,
        help="serve all figures to Prometheus at /metrics, and /healthz (default "
        f"127.0.0.1:{_PORT}); everyone who reaches the port can read them",
    )


def bound_metrics(args: argparse.Namespace) -> Mapping[str, PageListener]:
    """Bind what the option asks for, by process; ConfigError if that cannot be."""
    if args.metrics is None:
        return {}
    if find_spec("prometheus_client") is None:
        raise ConfigError("--metrics needs prometheus-client: pip install 'kontur-av[metrics]'")
    host, port = parse_page(args.metrics, "--metrics")
    return listeners(bind_pages(host, port, [METRICS]), host, None)


@contextmanager
def announced_metrics(
    bound: Mapping[str, PageListener], *, quiet: bool
) -> Iterator[Mapping[str, PageListener]]:
    """Print the address, and yield the listeners."""
    for listener in bound.values():
        if not quiet:
            with output_that_may_fail():
                print(f"metrics {listener.url('metrics').partition('?')[0]}", flush=True)
    try:
        yield bound
    finally:
        for listener in bound.values():
            listener.socket.close()
