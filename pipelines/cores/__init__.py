"""What the processes of a session do, without their sockets, topics and clocks.

The live processes (`pipelines.parts`) and the simulation drive the very same objects.
"""
