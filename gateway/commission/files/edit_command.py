"""What `decanter plc bind` and `import` share: the way they are carried out, and what they show."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gateway.commission.files.change import plant_findings
from gateway.commission.files.plan_files import Files, find_files
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, Target, perform
from gateway.console import CommandResult, Line, Part, Rows, shipped_file
from gateway.entry import sentences


def template() -> Path:
    """The shipped register map, whose write-back block is the pattern for new ones."""
    return shipped_file("devices", "decanter_plc")


def edit_files(
    given: SharedOptions, command: str, arguments: Mapping[str, Any], work: Callable[[Files], CommandResult]
) -> None:
    """Carry out a change of files as every command is: recorded, shown, with its exit code."""
    with sentences():
        files = find_files(given.plant, given.device, given.link, given.settings, given.machine)
        paths = tuple(path for path in (files.plant, files.device) if path is not None)
        target = Target("", files.driver, {}, files=paths)

    async def edit(_: Site) -> CommandResult:
        result = work(files)
        # None: no plant file was written, so that nothing is said of whether one is in order.
        judged = files.plant if result.data["written"] else None
        findings = None if judged is None else plant_findings(judged)
        return replace(result, data={**result.data, "findings": findings})

    perform(given, command, arguments, edit, _view, target=target)


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    if "columns" in data:
        columns = ", ".join(f"{name} = {header!r}" for name, header in data["columns"].items())
        yield f"{data['list']}: header in line {data['header_line']}: {columns}" if columns else data["list"]
        if data["left_out"]:
            yield f"no tags: {', '.join(data['left_out'])}"
        if data["ignored_columns"]:
            yield f"columns without use: {', '.join(map(repr, data['ignored_columns']))}"
        yield from (Line(note, "yellow") for note in data["not_taken"])
        keys = [key for key in _COLUMNS if any(tag.get(key) not in (None, "") for tag in data["tags"])]
        rows = [
            {key: f"{cell:.10g}" if isinstance(cell, float) else cell for key, cell in tag.items()}
            for tag in data["tags"]
        ]
        yield Rows(f"{len(rows)} tags", keys, rows)
    yield from (Line(problem, "red") for problem in data.get("problems", ()))
    for change in data.get("changes", ()):
        lines = change["diff"].splitlines()
        shown = lines[:_NEW_LINES] if change["new"] else lines  # of a new file only how it begins
        yield from (Line(line, {"+": "green", "-": "red", "@": "cyan"}.get(line[:1])) for line in shown)
        if len(lines) > len(shown):
            yield f"... and {len(lines) - len(shown)} lines more, as the table above says"
    if data["written"]:
        kept = f" (before: {', '.join(data['backups'])})" if data["backups"] else ""
        in_order = " and in order" if data["findings"] == [] else ""
        yield f"written{in_order}: {', '.join(data['files'])}{kept}"
        yield from (Line(finding, "yellow") for finding in data["findings"] or ())
    elif data["files"]:
        yield "dry run: nothing was written"
    elif not data.get("problems"):
        yield "nothing to change: the files say so already"


_NEW_LINES = 30
_COLUMNS = (
    "line",
    "name",
    "address",
    "dtype",
    "order",
    "bit",
    "scale",
    "scale_from",
    "offset",
    "unit",
    "low",
    "high",
    "sentinel",
    "period",
    "taken",
)
