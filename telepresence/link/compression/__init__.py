"""Compression of RTP headers to one to three octets on the link."""
