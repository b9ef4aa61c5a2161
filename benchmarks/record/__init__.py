"""`kontur-av bench record`."""
