"""A bench whose output pipe is closed."""

import json
import os
import subprocess
import sys

BENCH = """
import argparse, json, sys
from pipelines.report.report_file import open_console
console = open_console(argparse.Namespace(report=sys.argv[1], plot=None))
for number in range(100):
    console.print("ten letters " * 100, highlight=False)
open(sys.argv[1], "w").write(json.dumps({"printed": number}))
"""


def test_a_closed_pipe_is_no_failure_and_wanted_metrics_are_kept(tmp_path):
    path = tmp_path / "report.json"
    away, end = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", BENCH, str(path)], stdout=end, stderr=subprocess.PIPE
    ) as process:
        os.close(end)
        os.read(away, 1)
        os.close(away)
        _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, b"")
    assert json.loads(path.read_text()) == {"printed": 99}
