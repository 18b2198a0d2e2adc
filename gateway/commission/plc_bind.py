"""`decanter plc bind` and `import`: tags into the device file, by name or from an I/O list."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drivers.driver import capabilities
from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform_at
from gateway.commission.plc_read import ORDERS, TYPES
from gateway.console.output import sentences, table
from gateway.console.places import shipped

if TYPE_CHECKING:
    from gateway.commission.bind import Binding
    from gateway.commission.files.io_list import IoList
    from gateway.commission.files.plan_files import Files
    from gateway.commission.outcome import Outcome, Site


def _pair(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, str]:
    """A callback for LEFT=RIGHT, as often as it is given."""
    found = {}
    for text in texts:
        left, equals, right = text.partition("=")
        if not (equals and left.strip() and right.strip()):
            raise click.BadParameter(f"{text!r}: give {option.metavar}")
        found[left.strip()] = right.strip()
    return found


def _values(context: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, Any]:
    """A callback for KEY=VALUE whose values are TOML, or else text."""
    import tomllib

    found: dict[str, Any] = {}
    for key, text in _pair(context, option, texts).items():
        try:
            found[key] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            found[key] = text
    return found


_KEEP = click.option(
    "--keep",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_values,
    help="Also keep a setting: max_registers=16 in the device file, scan.period=1 in the plant file.",
)
_HEARTBEAT = click.option("--heartbeat", metavar="TAG", help="The tag that counts while the PLC's program runs.")
_DRY_RUN = click.option("--dry-run", is_flag=True, help="Show what would be changed; write nothing.")


@click.command()
@click.argument("name", required=False)
@click.argument("address", required=False)
@click.option("--type", "dtype", type=click.Choice(TYPES), help="What lies there (uint16).")
@click.option("--order", type=click.Choice(ORDERS), help="Byte and word order (ABCD).")
@click.option("--scale", type=float, help="Engineering units per count (1).")
@click.option("--offset", type=float, help="Engineering units at raw 0 (0).")
@click.option("--bit", type=click.IntRange(0, 15), help="One bit of the register.")
@click.option("--length", type=click.IntRange(1), help="Bytes of a string.")
@click.option("--guess", "rank", type=click.IntRange(1), help="Bind what the last guess found; 1 is its best.")
@click.option("--units", help="The engineering unit as text, such as degC.")
@click.option("--low", type=float, help="The lowest plausible value.")
@click.option("--high", type=float, help="The highest plausible value.")
@click.option("--sentinel", type=int, help="The raw number that means 'not available'.")
@click.option("--max-rate", type=float, help="The fastest believable change in units a second.")
@click.option("--label", "labels", multiple=True, metavar="RAW=TEXT", callback=_pair, help="A name of a raw number.")
@click.option("--block", metavar="ADDRESS", help="Where the write-back block begins.")
@click.option("--fields", help="Its fields, with commas between; as many as the PLC takes in one write by default.")
@click.option("--layout", type=click.IntRange(0, 65535), help="Its layout version (1).")
@click.option("--timer", type=float, help="The PLC's timer in seconds (5).")
@_HEARTBEAT
@_KEEP
@_DRY_RUN
@link_options
def bind(given: Given, **options: Any) -> None:
    """Bind a place in the device to a tag's NAME, in the device file: shown as a diff, checked, a backup kept.

    ADDRESS is a PDU address (holding:100), a number as HMIs show it (40101), or the link's own (0x2001:1). With --guess
    it is what the last guess found. Comments and order of the file stay. A file that is not there is made.
    Without NAME only --block, --heartbeat and --keep are put in.
    """

    def work(files: "Files") -> "Outcome":
        from gateway.commission.bind import Block, Wanted, carry_out
        from gateway.commission.files.plan_files import settings_of
        from gateway.commission.outcome import Outcome

        device, plant = settings_of(options["keep"])
        tags = [_binding(given, files, options)] if options["name"] else []
        block = None
        if options["block"]:
            names = options["fields"].replace(",", " ").split() if options["fields"] else None
            block = Block(_address(files, options["block"]), names, options["layout"], options["timer"])
        wanted = Wanted(tags, block, options["heartbeat"], device, plant)
        return Outcome(carry_out(files, wanted, _template(), dry_run=options["dry_run"]))

    if not any(options[key] for key in ("name", "block", "heartbeat", "keep")):
        raise click.UsageError("what is to be bound? Give NAME and ADDRESS, or --block, --heartbeat or --keep")
    _edit(given, "bind", {key: value for key, value in options.items() if value not in (None, (), {})}, work)


def _binding(given: Given, files: "Files", options: Mapping[str, Any]) -> "Binding":
    """The tag of the command line; a new place wins over the old one in all its keys."""
    from gateway.commission.bind import Binding, guessed
    from gateway.commission.files.device_file import ENCODING

    keys = {key: options[key] for key in (*ENCODING, "low", "high", "sentinel", "max_rate") if options[key] is not None}
    keys |= {"unit": options["units"]} if options["units"] is not None else {}
    keys |= {"labels": options["labels"]} if options["labels"] else {}
    if options["rank"] is not None:
        keys = guessed(given.records, options["rank"]) | keys
    if "address" in keys:
        keys["address"] = _address(files, str(keys["address"]))
    if keys.get("bit") is not None and "dtype" not in keys:
        keys["dtype"] = "bool"
    if not keys:
        raise ValueError(f"where is {options['name']!r}? Give its ADDRESS, or --guess 1 for what the last guess found")
    return Binding(options["name"], keys, place="address" in keys)


def _address(files: "Files", text: str) -> str:
    """A register as a PDU address, whichever way it is written; of any other device as it is. Raises ValueError."""
    from gateway.commission.survey.addresses import parse_register

    return str(parse_register(text)) if capabilities(files.driver).registers else text


@click.command("import")
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--sheet", help="The sheet of a workbook; the first by default.")
@click.option("--column", "columns", multiple=True, metavar="WHAT=HEADER", callback=_pair, help="Say what a column is.")
@click.option(
    "--table",
    "registers",
    type=click.Choice(["holding", "input", "coil", "discrete"]),
    default="holding",
    show_default=True,
    help="The table of bare numbers.",
)
@click.option("--order", type=click.Choice(ORDERS), default="ABCD", show_default=True, help="Order of wide values.")
@click.option("--shift", type=int, default=0, help="Add this to every address, such as -1 or 1.")
@click.option("--only", multiple=True, metavar="TAG", help="Only this tag; may be given again.")
@click.option("--without", multiple=True, metavar="TAG", help="Leave this tag out; may be given again.")
@click.option("--rename", multiple=True, metavar="OLD=NEW", callback=_pair, help="Give a tag of the list another name.")
@click.option("--skip-bad", is_flag=True, help="Leave out rows that cannot be used.")
@_HEARTBEAT
@_KEEP
@_DRY_RUN
@link_options
def import_list(given: Given, path: Path, **options: Any) -> None:
    """Take the tags of an I/O list (PATH: CSV or XLSX) into the device file: shown as a diff, checked, a backup kept.

    The columns are found by their headers, Italian or English; numbers may have a decimal comma. Each row that cannot
    be used is one sentence with its line, and then nothing is written (--skip-bad: nothing of that row). What the list
    does not say of a tag stays as it is in the file.
    """

    def work(files: "Files") -> "Outcome":
        from gateway.commission.bind import Wanted, bindings, import_outcome
        from gateway.commission.files.io_list import Reading, read_io_list
        from gateway.commission.files.plan_files import settings_of

        device, plant = settings_of(options["keep"])
        registers = capabilities(files.driver).registers
        how = Reading(options["registers"], options["order"], options["shift"], registers, options["rename"])
        found = read_io_list(path, how, options["columns"], options["sheet"])
        if options["only"] or options["without"]:
            found = _chosen(found, options["only"], options["without"])
        wanted = Wanted(bindings(found), None, options["heartbeat"], device, plant)
        said = {"dry_run": options["dry_run"], "skip": options["skip_bad"]}
        return import_outcome(found, files, wanted, _template(), **said)

    arguments = {"list": str(path), **{key: value for key, value in options.items() if value not in (None, (), {})}}
    _edit(given, "import", arguments, work)


def _chosen(found: "IoList", only: tuple[str, ...], without: tuple[str, ...]) -> "IoList":
    """The list with some tags alone, or without some. Raises ValueError for one that it does not have."""
    known = [tag.name for tag in found.tags]
    if missing := [name for name in (*only, *without) if name not in known]:
        raise ValueError(f"{missing[0]!r}: the list has no usable row of that name; it has {', '.join(known)}")
    tags = tuple(tag for tag in found.tags if (not only or tag.name in only) and tag.name not in without)
    return replace(found, tags=tags, problems=() if only else found.problems)


def _template() -> Path:
    return shipped("devices", "decanter_plc")


def _edit(given: Given, command: str, arguments: Mapping[str, Any], work: Any) -> None:
    """Carry out a change of files as every command is: recorded, shown, with its exit code."""
    with sentences():
        from gateway.commission.files.plan_files import find_files
        from gateway.commission.records import check_writable
        from gateway.commission.target import Target

        files = find_files(given.plant, given.device, given.link, given.settings)
        check_writable(given.records)
        paths = tuple(path for path in (files.plant, files.device) if path is not None)
        target = Target("", files.driver, {}, files=paths)

    async def done(_: "Site") -> "Outcome":
        found: Outcome = work(files)
        return found

    perform_at(target, given, command, arguments, done, _show)


def _show(data: Mapping[str, Any]) -> None:
    if "columns" in data:
        found = ", ".join(f"{name} = {header!r}" for name, header in data["columns"].items())
        click.echo(f"{data['list']}: header in line {data['header_line']}: {found}")
        if data["ignored_columns"]:
            click.echo(f"columns without use: {', '.join(map(repr, data['ignored_columns']))}")
        keys = [key for key in _COLUMNS if any(tag.get(key) not in (None, "") for tag in data["tags"])]
        rows = [[_text(tag.get(key, "")) for key in keys] for tag in data["tags"]]
        table(f"{len(rows)} tags", keys, rows)
    for problem in data.get("problems", ()):
        click.secho(problem, fg="red")
    for change in data.get("changes", ()):
        _show_change(change["diff"].splitlines(), most=_NEW_LINES if change["new"] else None)
    if data["written"]:
        kept = f" (before: {', '.join(data['backups'])})" if data["backups"] else ""
        click.echo(f"written and in order: {', '.join(data['files'])}{kept}")
    elif data["files"]:
        click.echo("dry run: nothing was written")
    elif not data.get("problems"):
        click.echo("nothing to change: the files say so already")


def _show_change(lines: list[str], most: int | None) -> None:
    """The diff; of a new file only how it begins."""
    for line in lines[:most]:
        click.secho(line, fg={"+": "green", "-": "red", "@": "cyan"}.get(line[:1]))
    if most is not None and len(lines) > most:
        click.echo(f"... and {len(lines) - most} lines more, as the table above says")


_NEW_LINES = 30
_COLUMNS = ("line", "name", "address", "dtype", "order", "bit", "scale", "offset", "unit", "low", "high", "sentinel")


def _text(value: Any) -> Any:
    return f"{value:.10g}" if isinstance(value, float) else value
