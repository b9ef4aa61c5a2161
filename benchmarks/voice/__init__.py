"""`python -m benchmarks voice`."""
