"""`kontur-av replay`: a recorded session through a link again, live."""

import argparse
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands.common import check_options
from pipelines.commands.live_session import end_session, made_directory
from pipelines.recording.process_replaying import ReplayStart, replayed_session
from pipelines.recording.recorded_session import RecordedSession
from pipelines.recording.replay_setup import load_replay
from pipelines.report.collector import Collector
from pipelines.report.live import session_view
from pipelines.report.model import ReplayedStream, ReplayReport
from pipelines.report.report_file import check_writable
from pipelines.report.session_feed import SessionFeed
from pipelines.session.launcher import Launcher, hold_ports, load_libraries
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options, stream_options
from pipelines.session.sessions import clear_dead_sessions, hold_session
from pipelines.session.setup.sources import check_room
from pipelines.session.setup.table import Setup, VideoStream
from pipelines.table import topology_of

#: All processes run, and the link is connected, this and two round trips after the start. On a full
#: machine they take 1.2 s.
_LEAD_NS = 4 * NS_PER_S
#: From the last instant until what was sent then is shown, without the radio's delay.
_TAIL_NS = 200 * NS_PER_MS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.mcap", type=Path, help="a recording")
    add_session_options(parser, "setup")
    add_options(
        parser,
        "--seconds S <float>  send its first S seconds only",
        "--speed X <float=1.0>  0.1 to 4 (default 1, the only one with voices)",
    )
    add_options(parser, "--recode", "--cap-kbps")
    add_session_options(parser, "radio", "radio_start", "radio_delay_ms", "seed", "base_port")
    add_session_options(parser, "report", "snapshots", "verbose", "quiet")
    parser.set_defaults(seed=None)


def run(args: argparse.Namespace) -> int:
    """Run the replay; 1 if its report names a failure."""
    if not 0.1 <= args.speed <= 4:
        raise ConfigError(f"--speed {args.speed:g}: take 0.1 to 4")
    check_options(args)
    recorded, setup = load_replay(args, args.file, speed=args.speed)
    if args.seconds is not None:
        recorded = recorded.begin(args.seconds)
    snapshots = args.snapshots and made_directory(args.snapshots, "--snapshots")
    check_writable(args.report)
    clear_dead_sessions()
    check_room(setup, setup.inputs)
    first_ns, last_ns = recorded.instants_ns
    delay_ns = setup.radio_profile.longest_delay_ns
    lead_ns = _LEAD_NS + 4 * delay_ns
    start = ReplayStart(recorded_ns=first_ns, lead_ns=lead_ns, speed=args.speed)
    plain = topology_of(setup, snapshots=snapshots is not None)
    topology = replayed_session(plain, recorded, start, recode=args.recode)
    length_ns = lead_ns + round((last_ns - first_ns) / args.speed) + delay_ns + _TAIL_NS
    held = hold_ports(topology)
    load_libraries()
    collector = Collector(topology)
    feed = SessionFeed(collector)
    with (
        hold_session(setup.name) as session,
        session_view(feed, quiet=args.quiet, verbose=args.verbose) as view,
    ):
        launcher = Launcher(
            session=session,
            topology=topology,
            processes=topology.processes,
            clock=MonotonicClock(),
            listener=collector,
            snapshots=snapshots,
            seed=recorded.metadata.seed if args.seed is None else args.seed,
            show=view.show,
            feed=feed,
        )
        launcher.run(length_ns / NS_PER_S)
    held.close()
    replay = _replay_report(recorded, setup, args)
    return end_session(stream_options(args), collector, launcher, replay=replay)


def _replay_report(
    recorded: RecordedSession, setup: Setup, args: argparse.Namespace
) -> ReplayReport:
    return ReplayReport(
        session=recorded.metadata.session,
        recorded_seed=recorded.metadata.seed,
        speed=args.speed,
        recoded=args.recode,
        streams={
            stream.name: ReplayedStream(units_recorded=len(recorded.pictures.get(stream.name, [])))
            for stream in setup.streams
            if isinstance(stream, VideoStream)
        },
        missing=recorded.missing,
    )
