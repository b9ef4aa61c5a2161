"""RTP (RFC 3550): payload formats, sender, receiver, playout and SDP."""
