"""`kontur-av bench fanout`."""
