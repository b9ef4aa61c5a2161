"""`python -m benchmarks record`."""
