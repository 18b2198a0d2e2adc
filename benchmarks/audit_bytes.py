"""What one armed block costs the disk: bytes that the audit log hands to the system, and bytes of pages it dirties.

`python -m benchmarks.audit_bytes [--blocks N]` stores the rows of N blocks, each waited for as before a send, and reads
/proc/self/io: `wchar` is what was written by calls, `write_bytes` what went to the disk in whole pages of 4 KiB.
"""

import tempfile
import time
from pathlib import Path

import click

from gateway.store import AuditEntry, open_audit

PACE_S = 0.1


def _io() -> dict[str, int]:
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    return {name: int(number) for name, number in (line.split(": ") for line in lines)}


@click.command()
@click.option("--blocks", default=1000, show_default=True)
@click.option("--pace", default=PACE_S, show_default=True, help="Seconds between two blocks.")
@click.option("--folder", type=click.Path(path_type=Path, exists=True), help="Where the log is made; on a real disk.")
def main(blocks: int, pace: float, folder: Path | None) -> None:
    """Bytes a block, and how long a block waits for its row."""
    with tempfile.TemporaryDirectory(dir=folder) as place:
        audit = open_audit(Path(place) / "audit.sqlite")
        before, waits = _io(), []
        for number in range(blocks):
            begun = time.perf_counter()
            detail = {"sequence": number, "validity": 31, "words": "0001" * 24}
            # Under the call by which the writer waits as well, so that the figure holds for earlier logs too.
            assert audit.record(AuditEntry(1.7e9 + number * pace, "write", "A. Rossi", "", detail))
            waits.append(time.perf_counter() - begun)
            time.sleep(pace)
        assert audit.close()
        after = _io()
        size = (Path(place) / "audit.sqlite").stat().st_size
    waits.sort()
    click.echo(
        f"{blocks} blocks: {(after['wchar'] - before['wchar']) / blocks:.0f} B written and "
        f"{(after['write_bytes'] - before['write_bytes']) / blocks:.0f} B of pages a block; the log grew by "
        f"{size / blocks:.0f} B a block; the wait p50 {waits[len(waits) // 2] * 1000:.1f} ms, "
        f"p99 {waits[int(len(waits) * 0.99)] * 1000:.1f} ms"
    )


if __name__ == "__main__":
    main()
