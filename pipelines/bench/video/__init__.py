"""`kontur-av bench video`."""
