"""RTP (RFC 3550) for H.264 and Opus: senders, receivers, the jitter buffer, and SDP.

Nothing here reads a socket or a clock: datagrams and instants come in, datagrams and events go out.
"""
