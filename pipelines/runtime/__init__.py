"""What every process of a live session stands on: launcher, context, sockets, probe."""
