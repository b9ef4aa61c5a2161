"""`kontur-av bench rtc`."""
