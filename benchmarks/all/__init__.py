"""`python -m benchmarks all`."""
