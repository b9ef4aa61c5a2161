"""The options of one end of a link that is split between two machines; whose an option is."""

from dataclasses import replace

from kontur_av.errors import ConfigError
from pipelines.link.own_ends import EndChoice, chosen_end
from pipelines.session.option_rows import refuse_options
from pipelines.session.options import StreamOptions
from pipelines.session.setup.table import Setup
from pipelines.session.topology import Segment, Topology
from pipelines.table import topology_of
from telepresence.haptics.specs import SIMULATED


def inputs_here(topology: Topology) -> tuple[str, ...]:
    """The names of the inputs that are captured on this machine."""
    return tuple(row.name for row in topology.inputs if topology.runs(row.process))


def ends_here(args: StreamOptions, setup: Setup) -> tuple[Topology, EndChoice | None]:
    """The table of the ends that run here, and the only one if it is alone.

    ConfigError for the first option of `stream` that belongs to the other end.
    """
    plan = topology_of(setup)
    one = chosen_end(args, plan)
    if one is not None:
        plan = replace(plan, segments=(one.segment,))
        _check_own_options(args, plan, one.segment)
    return plan, one


def _check_own_options(args: StreamOptions, topology: Topology, end: Segment) -> None:
    if end is Segment.GROUND and args.joystick != SIMULATED:
        raise ConfigError("--joystick: the joystick is in space; give it at --end space")
    if end is Segment.SPACE:
        why = ": a partner joins the ground; give it at --end ground"
        refuse_options(args, why, "rtc", "rtc_token_file", "rtc_hand_token_file", "ice_server")
    here = inputs_here(topology)
    for option in args.source:
        name = option.partition("=")[0]
        if name not in here:
            raise ConfigError(
                f"--source {option}: {name} is captured at --end {end.peer.value}; "
                f"this end has {', '.join(here) or 'no input'}"
            )
    _check_radio(topology.setup, end, trainer=args.trainer)
    if args.bypass:
        raise ConfigError("--bypass: both ends must be here; leave --end out")


def _check_radio(setup: Setup, end: Segment, *, trainer: bool) -> None:
    """ConfigError for a radio that changes with time: two ends would have two times for it."""
    radio = setup.radio_profile
    if radio.timed and not (trainer and end is Segment.SPACE):
        raise ConfigError(
            f"radio {radio.name} changes with time, and both ends would have a time of their own: "
            "give it at --end space with --trainer, and none at --end ground"
        )
