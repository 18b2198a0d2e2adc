"""What the work of a process has taken."""

import resource
from pathlib import Path

STATUS = Path("/proc/self/status")


def peak_megabytes(status: Path = STATUS) -> float:
    """The largest resident size of this process so far (10^6 bytes).

    Linux's `status` of a process has it of the present program alone; what `getrusage` says is never below that of the
    process by which this one was started.
    """
    if status.is_file():
        lines = status.read_text(encoding="utf-8").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
