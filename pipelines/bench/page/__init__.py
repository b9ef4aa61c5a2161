"""`kontur-av bench page`."""
