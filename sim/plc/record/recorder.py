"""The recorder: one JSON line for each thing that happened, in the file before the client can know of it.

Each line is written by one unbuffered append, so that a killed process loses nothing that it had answered, and memory
does not grow. Lines are numbered (`n`), so that a reader sees whether any is missing. Rows, by their kind `k`:

    run       a process began: its clock, device, trace, seed, the tags and by how much a register may round each
    truth     tags that changed, with their true values, and the image's version from here on
    request   one request, the reply, the faults that struck it, the version it was answered from
    block     one write into the write-back area, decoded, and the PLC's verdict
    frame     one CAN frame, sent or taken from the gateway
    event     anything else: a connection, a fault that begins or ends, a command, the end

`t` is monotonic seconds; the run's clock turns it into plant time.
"""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from sim.plc.program import InputError

Row = Mapping[str, object]
_encode = json.JSONEncoder(separators=(",", ":")).encode


class PlcRecorder:
    """Appends rows to a JSONL file. A row that cannot be written (disk full) is counted in `lost` and named once."""

    def __init__(self, path: Path, complain: Callable[[str], None]) -> None:
        """Open for appending. Raises InputError."""
        self.lost = 0
        self._path = path
        self._complain = complain
        self._number = 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); give a file in a directory of yours"
            ) from None
        self._broken = os.fstat(self._file).st_size > 0  # a killed run may have left half a line

    def __call__(self, kind: str, moment: float, row: Row) -> None:
        """Append one row."""
        self._number += 1
        text = _encode({"k": kind, "n": self._number, "t": moment, **row})
        line = f"\n{text}\n" if self._broken else f"{text}\n"
        data = line.encode()
        try:
            self._broken = os.write(self._file, data) < len(data)
        except OSError as error:
            self._broken = True
            if not self.lost:
                self._complain(
                    f"{self._path}: the recording has lost rows ({error.strerror}); it is no longer evidence"
                )
        self.lost += self._broken

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)
