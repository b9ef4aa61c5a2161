"""RTP (RFC 3550) for H.264 and Opus: senders, receivers, the jitter buffer, and SDP.

All modules here are cores: datagrams and instants come in, datagrams and events go out.
"""
