"""The decisions of a session's processes, without sockets, topics and clocks.

The live processes (`pipelines.parts`) and the simulation drive the same objects.
"""
