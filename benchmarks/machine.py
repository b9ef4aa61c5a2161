"""The machine of a measurement: a figure without it cannot be compared."""

import os
import platform
import re
from dataclasses import dataclass
from pathlib import Path

import av

_CPU_INFO = Path("/proc/cpuinfo")


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """cores: that this process may use."""

    cpu: str
    cores: int
    kernel: str
    python: str
    pyav: str

    def __str__(self) -> str:
        cores = f"{self.cores} core{'s' if self.cores > 1 else ''}"
        return f"{self.cpu}, {cores}, {self.kernel}, Python {self.python}, PyAV {self.pyav}"


def this_machine() -> Machine:
    """The machine on which this process runs (Linux, proc(5))."""
    text = _CPU_INFO.read_text(errors="replace") if _CPU_INFO.exists() else ""
    model = re.search(r"^model name\s*: (.*)$", text, re.M)
    return Machine(
        cpu=" ".join(model[1].split()) if model else platform.machine(),
        cores=len(os.sched_getaffinity(0)),
        kernel=f"{platform.system()} {platform.release()}",
        python=platform.python_version(),
        pyav=av.__version__,
    )
