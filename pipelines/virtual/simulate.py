"""Whole sessions on virtual time, from their setups to their reports."""

import gc
from collections.abc import Callable, Sequence

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.recording.recorded_session import RecordedSession
from pipelines.report.model import SessionReport
from pipelines.session.setup.table import Setup
from pipelines.virtual.agenda import CodingCosts
from pipelines.virtual.replay import Replay
from pipelines.virtual.session import Selection, Simulation
from pipelines.virtual.workers import Workers
from telepresence.haptics.device.device import JoystickDevice
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import SessionPlan

#: The virtual time between two checks whether to stop.
_STRIDE_NS = 50 * NS_PER_MS


def simulate(
    setup: Setup,
    *,
    seconds: float,
    seed: int,
    media: bool = True,
    selections: Sequence[Selection] = (),
    costs: CodingCosts | None = None,
    stopped: Callable[[], bool] = lambda: False,
    plan: tuple[SessionPlan, Catalogue] | None = None,
    joystick: JoystickDevice | None = None,
) -> SessionReport:
    """Simulate `seconds` of virtual time. The same arguments give the same report.

    plan: of `telepresence.tasks.plan_file.load_plan`; None: the hand taps targets all the time.
    joystick: as of `Simulation`.

    stopped: called again and again; True ends the simulation early.
    """
    with Workers() as workers:
        simulation = Simulation(
            setup,
            workers,
            seed=seed,
            media=media,
            selections=selections,
            costs=costs,
            plan=plan,
            joystick=joystick,
        )
        _run(simulation, round(seconds * NS_PER_S), stopped)
        return simulation.report()


def replay(
    session: RecordedSession,
    setup: Setup,
    *,
    seed: int,
    seconds: float | None = None,
    media: bool = True,
    costs: CodingCosts | None = None,
    recode: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> SessionReport:
    """Send a recorded session through the link of `setup` on virtual time.

    seconds: of virtual time; None: until everything has arrived. recode, seed, media, costs: as of
    `Replay`. stopped: as of `simulate`.
    """
    with Workers() as workers:
        simulation = Replay(
            session, setup, workers, seed=seed, media=media, costs=costs, recode=recode
        )
        end_ns = simulation.end_ns
        if seconds is not None:
            end_ns = min(end_ns, simulation.start_ns + round(seconds * NS_PER_S))
        _run(simulation, end_ns, stopped)
        return simulation.report()


def _run(simulation: Simulation, end_ns: int, stopped: Callable[[], bool]) -> None:
    # The present objects stay until the end, so the garbage collector need not visit them.
    gc.collect()
    gc.freeze()
    try:
        now_ns = simulation.start_ns
        while now_ns < end_ns and not stopped():
            now_ns = min(now_ns + _STRIDE_NS, end_ns)
            simulation.run(now_ns)
    finally:
        gc.unfreeze()
