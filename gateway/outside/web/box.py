"""The computer that the gateway runs on: disk, memory, load, how long it has been up."""

import os
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from gateway.settings import Config


def box_facts(config: Config) -> dict[str, Any]:
    """Bytes, seconds and shares as plain values; None for what this system does not tell."""
    folder = config.historian.path.parent
    disk: dict[str, int | None] = {"total": None, "free": None}
    with suppress(OSError):
        usage = shutil.disk_usage(folder)
        disk = {"total": usage.total, "free": usage.free}
    return {
        "disk": disk,
        "records": {
            "folder": str(folder.absolute()),
            "historian": _size(config.historian.path),
            "audit": _size(config.audit),
            "most": config.historian.max_mb * 1e6,
            "retention_days": config.historian.retention_days,
        },
        "memory": _memory(),
        "load": list(os.getloadavg()),
        "cores": os.cpu_count(),
        "time": time.time(),
        "up": time.clock_gettime(time.CLOCK_BOOTTIME),
        "pid": os.getpid(),
    }


def _size(path: Path) -> int | None:
    """Bytes of a database and what lies beside it."""
    try:
        return sum(file.stat().st_size for file in path.parent.glob(f"{path.name}*") if file.is_file())
    except OSError:
        return None


def _memory() -> dict[str, int | None]:
    """Bytes that this process has, and of the computer's all and those that can be had."""
    facts: dict[str, int | None] = {"process": None, "total": None, "available": None}
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        facts["process"] = pages * os.sysconf("SC_PAGE_SIZE")
        rows = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
        facts["total"] = int(rows["MemTotal"].split()[0]) * 1024
        facts["available"] = int(rows["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        pass  # another system: it is shown as not known
    return facts
