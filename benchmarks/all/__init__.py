"""`kontur-av bench all`."""
