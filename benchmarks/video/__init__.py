"""`python -m benchmarks video`."""
