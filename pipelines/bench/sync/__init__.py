"""`kontur-av bench sync`."""
