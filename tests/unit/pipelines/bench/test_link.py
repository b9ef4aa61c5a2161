"""`kontur-av bench link`: its figures, on short runs."""

import pytest

from pipelines.bench.link import parse_cyclictest


def test_the_output_of_cyclictest_is_parsed():
    output = (
        "# Histogram\n000005 000900\n000006 000089\n000007 000000\n000400 000010\n"
        "# Total: 000000999\n# Min Latencies: 00005\n# Max Latencies: 25000\n"
        "# Histogram Overflows: 00001\n"
    )
    assert parse_cyclictest(output).lateness_us == {
        "p50": 5.0,
        "p99": 400.0,
        "p99.9": 400.0,
        "max": 25000.0,
    }
    with pytest.raises(ValueError, match="no histogram"):
        parse_cyclictest("permission denied")
