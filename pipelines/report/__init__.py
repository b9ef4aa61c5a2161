"""From what processes report to one JSON report, a summary and a live table."""
