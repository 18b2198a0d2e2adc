"""The folder that `decanter init` makes: written beside its place, checked as `run` checks it, then put there."""

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tomlkit

from drivers.driver import capabilities
from drivers.named_files import name_write_errors
from drivers.settings import ConfigError, read_toml
from gateway.commission.files.change import FileChange, apply_change
from gateway.commission.files.plan_files import Files

PLANT, DEVICE, MAP, README, MODELS = "plant.toml", "devices/plc.toml", "columns.toml", "README.md", "models"
_ABOUT = """\
# {name}

Made by `decanter init`; a gateway for the PLC at {place}.

- `plant.toml`: the gateway's configuration; `devices/plc.toml`: where each tag lies in the PLC
- `columns.toml`: which column of a CSV is which signal, where a trace was given; `models/`: learned models
- `out/`: records, log and control socket, made by the first run

`decanter plc check` reads every tag once, `decanter run` runs the gateway, `decanter top` shows it.
`decanter docs` prints the documentation.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstFolder:
    """What is to be made: `files` are the plant and device file as if in `folder`, `change` what they say.

    `device` is a device file that is taken over, None for a new one; `map_text` a column map, "" for none. `template`
    is the shipped register map. `place` says where the PLC is.
    """

    folder: Path
    files: Files
    change: FileChange
    template: Path
    device: Path | None
    map_text: str
    place: str

    @property
    def existing_files(self) -> tuple[Path, ...]:
        """The files of that name that are there already."""
        names = (PLANT, DEVICE, README, *([MAP] if self.map_text else []))
        return tuple(self.folder / name for name in names if (self.folder / name).exists())

    def write(self) -> list[Path]:
        """Make the folder; gives its files. Those in the way are replaced; nothing is written where something is wrong.

        Raises ConfigError (a ValueError) or OSError.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        # In the same folder, so that each file takes its place in one step.
        with name_write_errors(self.folder), tempfile.TemporaryDirectory(prefix=".init-", dir=self.folder) as name:
            stage = Path(name)
            if self.device is not None:
                _copy_device(self.device, stage / DEVICE)
            files = replace(self.files, plant=stage / PLANT, device=stage / DEVICE)
            try:
                backups = apply_change(files, self.change, self.template, dry_run=False)["backups"]
            except ConfigError as error:
                # The sentences are about the folder that the person knows.
                problems = [problem.replace(f"{stage}/", f"{self.folder}/") for problem in error.problems]
                raise ConfigError(problems) from None
            for backup in backups:  # of what was made a moment ago
                Path(backup).unlink()
            about = _ABOUT.format(name=self.folder.absolute().name, place=self.place)
            (stage / README).write_text(about, encoding="utf-8")
            if self.map_text:
                (stage / MAP).write_text(self.map_text, encoding="utf-8")
            (self.folder / MODELS).mkdir(exist_ok=True)
            made = sorted(path.relative_to(stage) for path in stage.rglob("*") if path.is_file())
            for path in made:
                (self.folder / path).parent.mkdir(parents=True, exist_ok=True)
                (stage / path).replace(self.folder / path)
        return [self.folder / path for path in made]


def _copy_device(source: Path, target: Path) -> None:
    """Copy a device file, and beside it the files that it names. Raises ConfigError or OSError."""
    target.parent.mkdir(parents=True)
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    device: Mapping[str, Any] = read_toml(source).get("device", {})
    for key in capabilities(str(device.get("driver"))).files:
        named = device.get(key)
        if not isinstance(named, str) or not named:
            continue
        path = source.parent / named
        if path.is_dir():  # keys stay where they are
            document["device"][key] = str(path.absolute())
        else:
            shutil.copyfile(path, target.parent / path.name)
            document["device"][key] = path.name
    with name_write_errors(target):
        target.write_text(tomlkit.dumps(document), encoding="utf-8")
