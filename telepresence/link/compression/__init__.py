"""RTP headers in one to three octets on the link."""
