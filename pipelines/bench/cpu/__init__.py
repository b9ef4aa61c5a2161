"""`kontur-av bench cpu`."""
