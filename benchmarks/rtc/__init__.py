"""`python -m benchmarks rtc`."""
