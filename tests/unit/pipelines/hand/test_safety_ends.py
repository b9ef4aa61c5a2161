"""What the robot knows of the operator's sight."""

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.safety_ends import OperatorView
from pipelines.session.setup.setup_file import BUILT_IN


def test_the_robot_counts_a_picture_of_the_future_as_too_old():
    view = OperatorView(BUILT_IN["taskboard"])
    view.handle_shown(NS_PER_S, 40 * NS_PER_MS)
    assert not view.is_blind(NS_PER_S)
    view.handle_shown(NS_PER_S, -3_600 * NS_PER_S)
    assert view.is_blind(NS_PER_S)
