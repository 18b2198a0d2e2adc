"""The commands of `decanter keep`: configurations that were taken over, what differs between them, the way back."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import click

from drivers.named_files import normal_path
from drivers.settings import ConfigError, read_toml
from gateway.commission.session import login
from gateway.console import CommandResult, Part, Rows, conclude, find_service
from gateway.entry import Exit, fail, sentences
from gateway.outside.status import ControlError, connect
from gateway.plant import (
    FOLDER,
    KeptConfiguration,
    differences,
    history_folder,
    keep_files,
    kept_configurations,
    require_named_places,
    without_arming,
)
from gateway.replacement import draft_path, former_path, hold_folder, replace_files, write_draft
from gateway.settings import load_plant, read_plant
from gateway.store import BackupError

PATIENCE_S = 60.0
"""A machine that is stopped for a reload takes back what stands in its PLC first."""


def _list_configurations(path: Path, folder: Path | None) -> list[KeptConfiguration]:
    """The configurations of a plant file; also where that cannot be used any more, which is when they are wanted.

    Raises BackupError or OSError.
    """
    if folder is None:
        try:
            folder = history_folder(load_plant(path)[0])
        except ConfigError:
            folder = _fallback_folder(path)
    found = kept_configurations(folder)
    if not found:
        raise BackupError(f"{folder}: no configuration is kept there; a gateway keeps each one that it takes over")
    return found


def _fallback_folder(path: Path) -> Path:
    """The folder of a plant file that cannot be used: by what can be read of it, else where it is by default."""
    service = find_service(path.parent)
    records = path.parent / "out" if service is None else service.records
    with suppress(ConfigError, KeyError, TypeError):
        records = path.parent / Path(str(read_toml(path)["historian"]["path"])).parent
    return records / FOLDER


def _pick_configuration(found: Sequence[KeptConfiguration], number: int) -> KeptConfiguration:
    for one in found:
        if one.number == number:
            return one
    raise BackupError(f"there is no configuration {number}; there are {found[0].number} to {found[-1].number}")


def history(path: Path, folder: Path | None, as_json: bool) -> None:
    """The work of `keep history`."""
    with sentences():
        found = _list_configurations(path, folder)
    rows = [
        {
            "number": one.number,
            "time": one.manifest.made,
            "note": one.manifest.note,
            "program": one.manifest.program,
            "files": [file.original for file in one.manifest.files],
        }
        for one in found
    ]

    def show() -> Iterator[Part]:
        cells = [
            (str(one.number), _date(one.manifest.made), one.manifest.note, str(len(one.manifest.files)))
            for one in found
        ]
        yield Rows(f"{found[0].folder.parent}", ("number", "taken over", "at", "files"), cells)

    conclude(CommandResult({"configurations": rows}), lambda _: show(), as_json=as_json)


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S")


def diff(path: Path, folder: Path | None, old: int | None, new: int | None) -> None:
    """The work of `keep diff`."""
    with sentences():
        found = _list_configurations(path, folder)
        before = _pick_configuration(found, found[-1].number if old is None else old)
        if new is None:
            name, after = "now", {place: place.read_bytes() for place in before.files if place.is_file()}
        else:
            name, after = str(new), _pick_configuration(found, new).files
        lines = list(differences(before.files, after, (str(before.number), name)))
    click.echo("\n".join(lines) if lines else "nothing differs")


def rollback(path: Path, folder: Path | None, number: int, reason: str, by: str, as_json: bool) -> None:
    """The work of `keep rollback`."""
    with sentences():
        found = _list_configurations(path, folder)
        wanted = _pick_configuration(found, number)
        now, note = time.time(), f"before going back to {number}: {reason} ({by or login()})"
        plant, kept = normal_path(path), wanted.files
        if plant not in kept:
            raise BackupError(
                f"configuration {number} is of {next(iter(kept), 'nothing')}, not of {path}; give --config with that"
            )
        require_named_places(wanted.manifest, plant, kept, roles=("plant", "device"))
        roles = {Path(file.original): file.role for one in found for file in one.manifest.files}
        content = {place: without_arming(data) if place == plant else data for place, data in kept.items()}
        modes = {Path(file.original): file.mode for file in wanted.manifest.files}
        with hold_folder(plant):
            present = [(role, place) for place, role in roles.items() if place.is_file()]
            keep_files(wanted.folder.parent, present, now=now, note=note)
            former = [(place, former_path(place)) for place in content if place.is_file()]
            for _, file in former:
                file.unlink(missing_ok=True)  # of one that was killed behind its last step
            try:
                with _drafts(content, modes), replace_files(plant, content, former):
                    machines = read_plant(path)
            except ConfigError as error:
                raise BackupError(
                    f"configuration {number} cannot be used any more, and nothing is changed: {error}"
                ) from None
            for _, file in former:
                file.unlink()  # it is kept, in the newest configuration
        taken = "no gateway runs: it is taken over at the next start"
        if (line := connect(machines[0].control_socket, PATIENCE_S)) is not None:
            try:
                line.ask("reload")
                taken = "the running gateway has taken it over"
            except ControlError as error:
                fail(
                    f"the files of configuration {number} are back, and the gateway goes on as it was: {error}",
                    Exit.CHECK_FAILED,
                )
            finally:
                line.close()
    said = {"number": number, "files": list(map(str, content)), "said": taken}
    conclude(
        CommandResult(said),
        lambda _: [f"{len(content)} files are as in configuration {number}; {taken}"],
        as_json=as_json,
    )


@contextmanager
def _drafts(content: Mapping[Path, bytes], modes: Mapping[Path, int]) -> Iterator[None]:
    """Each file written beside its place, with the owner of what is there as far as this user may; none is left."""
    try:
        for place, data in content.items():
            status = place.stat() if place.is_file() else None
            write_draft(place, data, modes[place], None if status is None else (status.st_uid, status.st_gid))
        yield
    finally:
        for place in content:
            draft_path(place).unlink(missing_ok=True)
