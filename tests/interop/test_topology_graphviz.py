"""Graphviz draws the graph of `kontur-av topology --dot`."""

import re
import subprocess

import pytest
from programs import needs

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.tables import dot
from pipelines.table import topology_of

pytestmark = pytest.mark.interop


def corners(plain, name):
    """Left and right end of a box in the output of `dot -Tplain`, in inches."""
    x, width = re.search(rf"^node {name} (\S+) \S+ (\S+)", plain, re.MULTILINE).groups()
    return float(x) - float(width) / 2, float(x) + float(width) / 2


@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=lambda setup: setup.name)
def test_the_ground_is_left_of_its_gateway_and_space_right_of_its_own(setup):
    needs("dot")
    session = topology_of(setup, snapshots=True, pages=True)
    done = subprocess.run(
        ["dot", "-Tplain"], input=dot(session), capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    ground, space = (corners(done.stdout, f"{name}_gateway") for name in ("ground", "space"))
    assert ground[1] < space[0]
    for row in session.processes:
        if row.segment is None or row.name.endswith("_gateway"):
            continue
        left, right = corners(done.stdout, row.name)
        assert right < ground[0] if row.segment.value == "ground" else left > space[1]
