"""`kontur-av bench tasks`."""
