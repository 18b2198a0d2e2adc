"""The commands of `decanter machine`: the machines of a plant file, and of the gateway that runs with it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drivers.settings import with_place
from gateway.commission.files import Edit, commit, plant_findings, with_machine, without_machine
from gateway.console import CommandResult, Line, Part, Rows, conclude
from gateway.entry import sentences
from gateway.outside.status import ControlError, connect, judge_health, read_status
from gateway.settings import load_plant

RELOAD = "a gateway that runs takes it over with `decanter reload`"


def list_machines(path: Path, as_json: bool) -> None:
    """The work of `machine list`."""
    with sentences():
        configs = load_plant(path)
        health = _health(configs[0].control_socket)
    rows = [
        {
            "machine": config.machine,
            "device": config.map.name,
            "place": "; ".join(link.place for link in config.links),
            "temperatures": [row.tag for row in config.temperatures],
            "models": [row.model and str(row.model) for row in config.temperatures],
            "mode": config.writeback.mode,
            "health": health.get(config.machine),
        }
        for config in configs
    ]

    def show() -> Iterator[Part]:
        cells = [
            [
                config.machine,
                "; ".join(link.place for link in config.links),
                ", ".join(row.tag for row in config.temperatures),
                config.writeback.mode,
                health.get(config.machine, "–"),
            ]
            for config in configs
        ]
        count = f"{len(rows)} machine{'' if len(rows) == 1 else 's'}"
        yield Rows(f"{path}: {count}", ("machine", "place", "temperatures", "write-back", "now"), cells)

    conclude(CommandResult({"machines": rows}), lambda _: show(), as_json=as_json)


def _health(socket: Path) -> dict[str, str]:
    """How the machines of a running gateway are; nothing where none runs."""
    if (line := connect(socket)) is None:
        return {}
    try:
        statuses = line.ask("plant")["statuses"]
        return {name: str(judge_health(read_status(plain))) for name, plain in statuses.items()}
    except (OSError, ControlError):
        return {}
    finally:
        line.close()


def add(
    name: str,
    path: Path,
    device_file: str | None,
    temperatures: tuple[str, ...],
    dry_run: bool,
    as_json: bool,
    **place: Any,
) -> None:
    """The work of `machine add`."""
    predicted = [dict(zip(("tag", "model"), text.split("=", 1), strict=False)) for text in temperatures]
    with sentences():
        device = {key: value for key, value in {"file": device_file, **place}.items() if value is not None}
        # The port that stands with the host wins over the common one.
        edit = with_machine(path, name, with_place(device) if "host" in device else device, predicted)
        _apply_edit(edit, dry_run=dry_run, as_json=as_json)


def remove(name: str, path: Path, dry_run: bool, as_json: bool) -> None:
    """The work of `machine remove`."""
    with sentences():
        _apply_edit(without_machine(path, name), dry_run=dry_run, as_json=as_json)


def _apply_edit(edit: Edit, *, dry_run: bool, as_json: bool) -> None:
    backup = None if dry_run else commit(edit, load_plant)
    findings = [] if dry_run else plant_findings(edit.path)

    def show() -> Iterator[Part]:
        for line in edit.diff().splitlines():
            yield Line(line, {"+": "green", "-": "red", "@": "cyan"}.get(line[:1]))
        yield "dry run: nothing was written" if dry_run else f"written (before: {backup}); {RELOAD}"
        for finding in findings:
            yield Line(finding, "yellow")

    data = {"diff": edit.diff(), "written": not dry_run, "backup": backup and str(backup), "findings": findings}
    conclude(CommandResult(data), lambda _: show(), as_json=as_json)
