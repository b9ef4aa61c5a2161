"""Any octets: a message with a wall is refused, or packing it again gives the same octets."""

from hypothesis import given
from hypothesis import strategies as st

from telepresence.haptics.mediated.controller import MediatedController
from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall

WALL = pack_wall(WallMessage(7, Wall(0.5, 0.06, 1500.0)), 3)
near = st.builds(
    lambda at, octet: WALL[:at] + bytes([octet]) + WALL[at + 1 :],
    st.integers(0, len(WALL) - 1),
    st.integers(0, 255),
)


@given(st.lists(st.binary(max_size=24) | near, max_size=20))
def test_any_messages_are_each_counted_and_no_force_leaves_its_bounds(datagrams):
    controller = MediatedController()
    controller.step(None, 0.05, 0.0, 1_000_000)
    before = 0.0
    for number, datagram in enumerate(datagrams):
        controller.handle_wall(datagram)
        fx, fy = controller.step(None, 0.05 + 0.001 * number, 0.0, 1_000_000)
        force = (fx * fx + fy * fy) ** 0.5
        assert force <= controller.limit_n
        assert controller.renderer.tank_j >= 0.0
        assert abs(force - before) < 8.0
        before = force
    renderer = controller.renderer
    assert controller.garbage + renderer.used + renderer.stale == len(datagrams)
