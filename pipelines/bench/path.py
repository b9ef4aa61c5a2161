"""`kontur-av bench path`: a network between two ends that run here, such as `lte`. A shell."""

import argparse

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.hosts import parse_address
from pipelines.link.relay import PathRelay
from pipelines.session.command_process import say, stopped_by_signals
from pipelines.session.datagrams import LOOPBACK
from pipelines.session.option_rows import add_options
from telepresence.link.link_metrics import address_text
from telepresence.link.radio.network import NetworkPath
from telepresence.link.radio.profile import BUILT_IN
from telepresence.link.radio.profile_file import load_radio

_NETWORKS = ", ".join(name for name, profile in BUILT_IN.items() if profile.network)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"network  {_NETWORKS}, or FILE.toml with [network]",
        "--peer HOST:PORT <!>  the end that listens",
        f"--listen ADDR:PORT <={LOOPBACK}:27100>  what the other end calls in its place "
        f"({LOOPBACK}:27100)",
        "--seed N <int=0>  of losses and delays (default 0)",
        "--seconds S <float>  end after S seconds (default: Ctrl-C)",
    )


def run(args: argparse.Namespace) -> int:
    """Carry datagrams until it is told to end; then say what became of them."""
    profile, clock = load_radio(args.network), MonotonicClock()
    if profile.network is None:
        raise ConfigError(
            f"radio {profile.name} has no network: take {_NETWORKS}, or a file with [network]"
        )
    began_ns = clock.now_ns()
    out, back = (
        NetworkPath(profile.network, f"{args.seed} {way}", epoch_ns=began_ns)
        for way in ("out", "back")
    )
    target, front = parse_address(args.peer, "--peer"), parse_address(args.listen, "--listen")
    try:
        relay = PathRelay(target, out, back, clock.now_ns, front=front)
    except OSError as error:
        raise ConfigError(f"--listen {args.listen}: {error.strerror}; take another one") from None
    say(f"{profile.name}: the end that calls takes --peer {address_text(relay.address)}")
    end_ns = None if args.seconds is None else began_ns + round(args.seconds * NS_PER_S)
    with stopped_by_signals() as stopped:
        relay.run(lambda: stopped() or (end_ns is not None and clock.now_ns() >= end_ns))
    for name, way in (("to the listening end", out), ("from it", back)):
        say(
            f"{name}: {way.sent} datagrams, {way.lost} lost, {way.overflows} without room in the "
            f"queue, {way.reordered} overtaken, {way.repeated} twice; "
            f"{way.most_queued_ns / NS_PER_MS:.0f} ms in the queue at most"
        )
    return 0
