"""The table of a session: a row for every process, stream and topic.

Launcher, simulation, ports, report and documents derive from it. Each process belongs to a segment.
Processes of one segment share topics; only streams of the radio link cross to the other segment.
The exceptions are `robot/state` and `mission/leds`, from which the built-in scenes draw the
simulated world. Without the former they show a scripted motion.

`pipelines.table.topology_of(setup)` gathers it. `rows.py` says what a row is, `table.py` has the
whole, `topics.py` lists the topics, `streams.py` what the link carries, with ports. The processes
are in the `rows.py` of their rooms. A new process is a row there, and a module `process_NAME.py`
beside it.
"""
