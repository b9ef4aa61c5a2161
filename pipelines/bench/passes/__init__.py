"""`kontur-av bench passes`."""
