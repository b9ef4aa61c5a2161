"""`kontur-av topology`: the processes, streams and topics of a session."""

import argparse
import shutil

from pipelines.session.command_process import print_data
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options, asked_setup, stream_options
from pipelines.session.topology.tables import dot, processes_table, streams_table, topics_table
from pipelines.table import topology_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session_options(parser, "setup!", "base_port")
    add_options(parser, "--dot  a graph for Graphviz instead")


def run(args: argparse.Namespace) -> int:
    topology = topology_of(asked_setup(stream_options(args)), pages=True)
    if args.dot:
        text = dot(topology)
    else:
        width = shutil.get_terminal_size().columns
        parts = {
            "Processes, in the order in which they are started": processes_table(topology),
            "Streams on the radio link: caps in kbit/s, UDP ports": streams_table(topology),
            "Topics in shared memory": topics_table(topology),
        }
        text = "\n\n".join(
            "\n".join([heading, "", *table.lines(width)]) for heading, table in parts.items()
        )
    print_data(text.rstrip("\n") + "\n")
    return 0
