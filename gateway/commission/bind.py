"""`decanter plc bind`: a place in the device bound to a tag's name, in the device file's own text."""

from pathlib import Path
from typing import Any

import click

from drivers.driver import capabilities
from drivers.settings import ConfigError
from gateway.commission.files import (
    ENCODING,
    Binding,
    BlockPlace,
    FileChange,
    Files,
    apply_change,
    edit_files,
    split_settings,
    template,
)
from gateway.commission.options import SharedOptions
from gateway.commission.session import read_records
from gateway.commission.survey import parse_register
from gateway.console import CommandResult

_LIMITS = ("low", "high", "sentinel", "max_rate")


def bind(given: SharedOptions, **options: Any) -> None:
    """The work of `plc bind`."""

    def work(files: Files) -> CommandResult:
        device, plant = split_settings(options["keep"])
        tags = []
        if options["name"]:
            keys = {key: options[key] for key in (*ENCODING, *_LIMITS) if options[key] is not None}
            keys |= {"unit": options["units"]} if options["units"] is not None else {}
            keys |= {"labels": options["labels"]} if options["labels"] else {}
            if options["rank"] is not None:
                # What was guessed gives way to what is given.
                keys = keys_of_guess(given.records, options["rank"]) | keys
            if "address" in keys:
                keys["address"] = _address(files, str(keys["address"]))
            if keys.get("bit") is not None and "dtype" not in keys:
                keys["dtype"] = "bool"
            if not keys:
                name = options["name"]
                raise ValueError(f"where is {name!r}? Give its ADDRESS, or --guess 1 for what the last guess found")
            # A new place wins over the old one in all its keys.
            tags.append(Binding(options["name"], keys, place="address" in keys))
        block = None
        if options["block"]:
            names = options["fields"].replace(",", " ").split() if options["fields"] else None
            address = _address(files, options["block"])
            block = BlockPlace(address, options["block_of"], names, options["layout"], options["timer"])
        wanted = FileChange(tags, block, options["heartbeat"], device, plant)
        return CommandResult(apply_change(files, wanted, template(), dry_run=options["dry_run"]))

    if options["block_of"] and not options["block"]:
        raise click.UsageError("--block-of says which block --block places; give --block ADDRESS too")
    if not any(options[key] for key in ("name", "block", "heartbeat", "keep")):
        raise click.UsageError("what is to be bound? Give NAME and ADDRESS, or --block, --heartbeat or --keep")
    edit_files(given, "bind", {key: value for key, value in options.items() if value not in (None, (), {})}, work)


def _address(files: Files, text: str) -> str:
    """A register as a PDU address, whichever way it is written; of any other device as it is. Raises ValueError."""
    return str(parse_register(text)) if capabilities(files.driver).registers else text


def keys_of_guess(records: Path, rank: int) -> dict[str, Any]:
    """The keys of the candidate of that rank (1 the best) of the newest guess in the records. Raises ConfigError."""
    guesses = [record for record in read_records(records) if record.command == "guess"] if records.exists() else []
    if not guesses:
        raise ConfigError(
            [f"{records}: holds no guess; run `decanter plc guess` first, or give the address and --type"]
        )
    result = guesses[-1].result
    candidates = result.get("candidates") or [{**bit, "dtype": "bool"} for bit in result.get("bits", [])]
    if not candidates:
        raise ConfigError(["--guess: the last guess found nothing; repeat it, or give the address and --type"])
    if not 1 <= rank <= len(candidates):
        raise ConfigError([f"--guess {rank}: the last guess has {len(candidates)} candidates; give 1 for the best"])
    candidate = candidates[rank - 1]
    return {key: candidate[key] for key in ENCODING if candidate.get(key) is not None}
