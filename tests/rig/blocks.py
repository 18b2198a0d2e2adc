"""What the blocks that a PLC received must stand up to: each has its row, and no usable one spoke of the past."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from struct import pack

from drivers.tag import Quality, Sample
from gateway.machine.writing import WRITE, Validity
from gateway.store.audit import read
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording
from tests.rig.pair import TEMPERATURE

SLACK_S = 1.0
"""By how much a block's temperature may be older than it says: a cycle of the PLC, a scan and the filter's own lag."""
ROUNDING = 0.5
"""degC between the filter's mean and a reading."""


def unaccounted(recording: PlcRecording, audit: Path) -> int:
    """How many blocks that the PLC received have no row in the audit log."""
    rows = Counter(row.entry.detail["words"] for row in read(audit, [WRITE]))
    return (Counter(pack(f">{len(block.words)}H", *block.words).hex() for block in recording.blocks) - rows).total()


def old_numbers(recording: PlcRecording) -> int:
    """How many accepted blocks were usable and spoke of a temperature that was not there any more."""
    samples = [
        Sample(TEMPERATURE, block.fields["temperature_now"], Quality.GOOD, block.time, block.time - block.fields["age"])
        for block in recording.blocks
        if block.accepted and block.fields and int(block.fields["validity"]) & Validity.USABLE
    ]
    runs = [replace(run, roundings={**run.roundings, TEMPERATURE: (ROUNDING, 0.0)}) for run in recording.runs]
    return len(wrong_good(replace(recording, runs=runs), samples, SLACK_S))
