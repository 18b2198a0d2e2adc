"""What the blocks that a PLC received must stand up to: each has its row, and no usable one spoke of the past."""

from bisect import bisect_right
from collections import Counter
from pathlib import Path
from struct import pack

from gateway.machine.writing import WRITE, Validity
from gateway.store.audit import read
from sim.plc.record.recording import PlcRecording
from tests.rig.pair import TEMPERATURE

SLACK_S = 0.2
"""By how much a block may be older than it says: a cycle of the PLC and a scan."""
ROUNDING = 0.1
"""degC by which a band may miss a temperature: what registers and the filter's last reading leave."""


def unaccounted(recording: PlcRecording, audit: Path) -> int:
    """How many blocks that the PLC received have no row in the audit log."""
    rows = Counter(row.entry.detail["words"] for row in read(audit, [WRITE]))
    return (Counter(pack(f">{len(block.words)}H", *block.words).hex() for block in recording.blocks) - rows).total()


def old_numbers(recording: PlcRecording) -> int:
    """How many accepted blocks were usable, and the bearing had no temperature in their band since their age.

    Made for a model whose band widens as fast as the temperature moves (`FOLLOWING`).
    """
    truth = sorted((row.time, row.value) for row in recording.truth if row.tag == TEMPERATURE and row.value is not None)
    times = [time for time, _ in truth]
    old = 0
    for block in recording.blocks:
        fields = block.fields
        if not (block.accepted and fields and int(fields["validity"]) & Validity.USABLE):
            continue
        since = max(bisect_right(times, block.time - fields["age"] - SLACK_S) - 1, 0)
        low, high = fields["band_low"] - ROUNDING, fields["band_high"] + ROUNDING
        old += not any(low <= float(value) <= high for _, value in truth[since : bisect_right(times, block.time)])
    return old
