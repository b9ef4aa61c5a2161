"""`kontur-av bench voice`."""
