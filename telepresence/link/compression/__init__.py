"""Compression of RTP headers to one to four octets on the link."""
