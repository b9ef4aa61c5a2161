"""`kontur-av bench latency`."""
