"""The base of every live process: launcher, context, sockets, probe."""
