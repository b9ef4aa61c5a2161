"""What the options of files and services give to processes."""

import inspect
import pkgutil
import socket

from pipelines.commands.session_ways import files_arguments
from pipelines.files.service_sockets import bound_services
from pipelines.session.options import StreamOptions
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.topics import FILES, PAGES
from pipelines.table import topology_of


def test_each_process_takes_what_it_is_given(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    args = StreamOptions(
        files=tmp_path, service=(f"ssh={port}",), service_allow=("ssh=127.0.0.1:22",)
    )
    topology = topology_of(BUILT_IN["taskboard"], files=True, pages=True)
    ends = tuple(Segment)
    with bound_services(args, files_arguments(args, ends), ends) as arguments:
        assert {*arguments} == {*FILES.values(), PAGES[Segment.GROUND]}
        for name, given in arguments.items():
            row = topology.process(name)
            inspect.signature(pkgutil.resolve_name(row.run)).bind(None, **row.arguments, **given)
        ground, space = (arguments[FILES[end]]["services"] for end in ends)
        assert ({*ground.listeners}, {*ground.targets}) == ({"ssh"}, set())
        assert ({*space.listeners}, {*space.targets}) == (set(), {"ssh"})
