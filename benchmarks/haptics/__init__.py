"""`python -m benchmarks haptics`."""
