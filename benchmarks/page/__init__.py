"""`python -m benchmarks page`."""
