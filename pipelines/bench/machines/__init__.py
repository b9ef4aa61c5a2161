"""`kontur-av bench machines`."""
