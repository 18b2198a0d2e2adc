"""A backup of the gateway made on a person's word, as by `decanter keep backup`: a new folder beside the records."""

import asyncio
import json
import time
from pathlib import Path
from typing import Any

from drivers.errors import OneLineError
from gateway.outside.web.box import box_facts
from gateway.outside.web.program import ProgramRefused, run_program
from gateway.settings import Config

FOLDER = "backups"
"""Below the folder of the records."""
PATIENCE_S = 3600.0


class BackupRefused(OneLineError):
    """No backup was made; the message is one sentence."""


class BackupMaker:
    """Makes one backup at a time."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._making = asyncio.Lock()

    def next_folder(self) -> Path:
        """Where a backup that is made now will be; it bears the time (UTC). Raises BackupRefused where none can be."""
        if self._making.locked():
            raise BackupRefused("a backup is being made; wait for its end")
        facts = box_facts(self._config)
        size = sum(facts["records"][name] or 0 for name in ("historian", "audit"))
        free = facts["disk"]["free"]
        if free is not None and free < size + 1e6 * self._config.alarms.disk_mb:
            raise BackupRefused(
                f"{free / 1e6:.0f} MB are left on the records' disk and the backup takes about {size / 1e6:.0f} MB; "
                "make room, or make it on another disk with `decanter keep backup FOLDER`"
            )
        name = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        return (self._config.historian.path.parent / FOLDER / name).absolute()

    async def make(self, folder: Path) -> dict[str, Any]:
        """Make the backup; gives `folder`, how many `files` and `bytes` are in it, its `seal`, whether it is `signed`,
        and what is `damaged` in it. Raises BackupRefused."""
        async with self._making:
            folder.parent.mkdir(mode=0o700, exist_ok=True)
            try:
                said = await run_program(
                    *("keep", "backup", str(folder), "--config", str(self._config.path), "--json"), patience=PATIENCE_S
                )
            except TimeoutError:
                raise BackupRefused(f"it was not made within {PATIENCE_S:g} s; make it at the box") from None
            except ProgramRefused as error:
                raise BackupRefused(str(error) or "no backup was made") from None
        made = json.loads(said)
        return {key: made[key] for key in ("folder", "files", "bytes", "seal", "signed", "damaged")}
