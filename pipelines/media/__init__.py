"""Cameras, stereo merge, senders, receivers, displays and snapshots of a session."""
