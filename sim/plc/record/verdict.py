"""The judge as a command: `python -m sim.plc.record.verdict RECORDING SAMPLES` compares samples with the truth.

SAMPLES has one JSON object a line: {"tag": ..., "value": ..., "quality": ..., "time": ..., "sent": ...}, times
in plant seconds, quality as an OPC UA status code. One JSON object is printed; the exit code is 1 if a wrong value was
good. For programs that may not import the software PLC, the gateway first of all.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import click

from drivers.tag import Quality, Sample
from sim.plc.program import InputError, read_text
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording, read_recording

MAX_LISTED = 5


def read_samples(path: Path) -> Iterator[Sample]:
    """The samples of a file. Raises InputError with file, line and reason."""
    for number, line in enumerate(read_text(path, "samples of a client").splitlines(), start=1):
        try:
            yield _sample(json.loads(line))
        except (ValueError, KeyError, TypeError) as error:
            reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
            raise InputError(
                f"{path}: line {number}: is no sample ({reason}); give tag, value, quality, time and, if known, sent"
            ) from None


def _sample(row: Mapping[str, Any]) -> Sample:
    value, sent = row["value"], row.get("sent")
    if not isinstance(value, bool | int | float | str | None):
        raise TypeError(f"value {value!r} is no number, text, true, false or null")
    moments = [float(row["time"]), float(row["time"] if sent is None else sent)]
    if not all(map(isfinite, moments)) or moments[1] > moments[0]:
        raise ValueError(f"time {row['time']!r} and sent {sent!r} are no moments of which sent is not the later")
    return Sample(row["tag"], value, Quality(row["quality"]), moments[0], None if sent is None else moments[1])


def counts(recording: PlcRecording) -> dict[str, Any]:
    """What the PLC saw of the gateway: requests, blocks accepted and refused, rows that the recording lacks.

    `blocks` has the accepted and refused ones of each block by its suffix.
    """
    accepted = sum(block.accepted for block in recording.blocks)
    verdicts = Counter((block.block, block.accepted) for block in recording.blocks)
    return {
        "requests": len(recording.requests),
        "writes_outside": sum(
            request.function in (5, 6, 15, 16, 22, 23) and request.exception is not None
            for request in recording.requests
        )
        + sum(row.event == "write refused" for row in recording.events),
        "blocks_accepted": accepted,
        "blocks_refused": len(recording.blocks) - accepted,
        "blocks": {
            suffix: {"accepted": verdicts[suffix, True], "refused": verdicts[suffix, False]}
            for suffix in sorted({block.block for block in recording.blocks})
        },
        "missing": recording.missing,
        "damaged": recording.damaged,
    }


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("samples", type=click.Path(path_type=Path))
@click.option(
    "--tolerance",
    type=click.FloatRange(0, 86_400),
    default=0.0,
    show_default=True,
    help="Age (plant s) that a good value may have.",
)
def main(recording: Path, samples: Path, tolerance: float) -> None:
    """Say how many good samples were wrong, by the software PLC's own recording."""
    try:
        seen = read_recording(recording)
        judged = list(read_samples(samples))
    except (InputError, OSError) as error:
        click.echo(f"verdict: {error}", err=True)
        sys.exit(2)
    wrong = wrong_good(seen, judged, tolerance)
    examples = [{"time": verdict.sample.time, "reason": verdict.reason} for verdict in wrong[:MAX_LISTED]]
    faults = [{"event": row.event, "time": row.time, "monotonic": row.monotonic, **row.detail} for row in seen.events]
    good = sum(sample.quality.is_good for sample in judged)
    result = {"judged": len(judged), "good": good, "wrong_good": len(wrong), "examples": examples}
    click.echo(json.dumps(result | counts(seen) | {"events": faults}))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
