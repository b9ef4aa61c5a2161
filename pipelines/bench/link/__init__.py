"""`kontur-av bench link`."""
