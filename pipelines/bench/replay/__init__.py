"""`kontur-av bench replay`."""
