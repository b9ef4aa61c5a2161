"""`kontur-av bench haptics`."""
