"""What is changed in a device file: tags, settings of the driver, the write-back block; and new files to begin with."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT, Comment, Table, Whitespace

from drivers.device_file import NEEDED_FIELDS
from drivers.driver import capabilities
from drivers.settings import ConfigError, read_toml
from gateway.commission.files.toml_edit import set_key
from gateway.commission.writeback.fields import describe_field
from gateway.settings import BLOCK_FIELDS

PLACE_KEYS = (
    *("transport", "host", "port", "timeout", "certificates", "tls_name", "serial", "baud", "parity", "stopbits"),
    *("echo", "longest_reply", "interface", "channel", "bitrate"),
)
"""Settings that say where a device is; they belong into the plant file, all others into the device file."""
ENCODING: Mapping[str, Any] = {
    **{"address": None, "dtype": "uint16", "order": "ABCD", "scale": 1.0, "offset": 0.0, "bit": None, "length": 0},
}
"""The keys of a tag that say how its value lies in the device, with their defaults."""
LEAVE_OUT = (
    *("band_low", "band_high", "minutes_low", "minutes_high", "horizon_low", "model_hash", "anomaly", "location"),
    *("horizon_median", "horizon", "age", "minutes_median", "p_limit", "input_quality", "zone", "temperature_now"),
    *("horizon_high", "alarms"),
)
"""In this order fields are left out where a PLC takes too few words in one write: what is missed least comes first."""


def starter(name: str, driver: str) -> str:
    """A device file to begin with, without a tag."""
    document = tomlkit.document()
    document.add(tomlkit.comment(f"The device {name}: where each tag lies. `decanter plc check` says what is wrong."))
    if capabilities(driver).registers:
        document.add(tomlkit.comment("Addresses are PDU addresses (0-based): holding:100 is 40101 counted from 40001."))
    document.add(tomlkit.nl())
    table = tomlkit.table()
    table["name"], table["driver"] = name, driver
    document["device"] = table
    return tomlkit.dumps(document)


def set_device(document: tomlkit.TOMLDocument, settings: Mapping[str, Any]) -> None:
    """Keys of [device]; None takes one out."""
    if "device" not in document:
        document["device"] = tomlkit.table()
    for key, value in settings.items():
        set_key(document["device"], key, value)


def set_tag(document: tomlkit.TOMLDocument, name: str, keys: Mapping[str, Any]) -> None:
    """Put the given keys into the tag of this name, which is made where it is not there; None takes a key out."""
    tags = _tags(document)
    table = next((tag for tag in tags if tag.get("name") == name), None)
    if table is not None:
        _fill(table, keys)
        return
    table = tomlkit.table()
    table["name"] = name
    _fill(table, keys)
    # After the last tag, and before the blank lines and comments at its end: TOML counts them to that tag, and a person
    # to the table that follows.
    if len(tags):
        body = tags[-1].value.body
        following: list[Comment | Whitespace] = []
        while body and body[-1][0] is None and isinstance(item := body[-1][1], Comment | Whitespace):
            following.insert(0, item)
            body.pop()
        tags[-1].add(tomlkit.nl())
        for item in following:
            table.add(item)
    tags.append(table)


def set_derived(document: tomlkit.TOMLDocument, name: str, law: Mapping[str, Any]) -> None:
    """Put a signal that is made of tags into [derived]."""
    if "derived" not in document:
        document["derived"] = tomlkit.table()
    inline = tomlkit.inline_table()
    inline.update(law)
    set_key(document["derived"], name, inline)


def _fill(table: Table, keys: Mapping[str, Any]) -> None:
    for key, value in keys.items():
        if isinstance(value, Mapping):
            inline = tomlkit.inline_table()
            inline.update(value)
            set_key(table, key, inline)
        else:
            set_key(table, key, value)


def encoding(keys: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a place as a tag has them: what is the default is not written."""
    return {
        key: None if keys.get(key) is None or keys[key] == default else keys[key] for key, default in ENCODING.items()
    }


def _tags(document: tomlkit.TOMLDocument) -> AoT:
    tags = document.get("tags")
    if tags is None:
        document["tags"] = tags = tomlkit.aot()
        tags = document["tags"]
    if not isinstance(tags, AoT):
        raise ConfigError(["tags: is written as a plain list; write each as a [[tags]] table"])
    return tags


# ---------------------------------------------------------------- the block


def fields_that_fit(words: int) -> list[str]:
    """The most useful fields for a PLC that takes so many words in one write. Raises ConfigError for too few."""
    left = list(BLOCK_FIELDS)
    for name in LEAVE_OUT:
        if len(left) <= words:
            break
        left.remove(name)
    if len(left) > words:
        raise ConfigError(
            [f"the PLC takes {words} words in one write, and a block has at least {len(left)}: it cannot be written"]
        )
    return left


def further_block(document: tomlkit.TOMLDocument, temperature: str | None) -> Any:
    """The `[[writeback.blocks]]` table of this temperature; None where that of `[writeback]` itself is meant.

    Raises ConfigError where nothing says which of several is meant, or no block speaks of the temperature.
    """
    table: Any = document.get("writeback", {})
    rows, first = table.get("blocks", ()), table.get("temperature")
    known = [str(first or "the first"), *(str(row.get("temperature")) for row in rows)]
    if temperature is None:
        if rows:
            raise ConfigError(
                [f"--block: the device file has {len(known)} blocks; say which with --block-of {' or '.join(known)}"]
            )
        return None
    row = next((row for row in rows if row.get("temperature") == temperature), None)
    if row is None and first not in (None, temperature):
        raise ConfigError(
            [
                f"--block-of: no block of the device file speaks of {temperature!r}, only of {', '.join(known)}; "
                "for one more add a [[writeback.blocks]] table with temperature, address and suffix"
            ]
        )
    return row


def set_block(
    document: tomlkit.TOMLDocument, head: Mapping[str, Any], names: Sequence[str] | None, template: Path
) -> None:
    """The [writeback] table: `head` are its keys (None takes one out), `names` its fields (None: as they are).

    Type and scale of a field that is not there yet are those of the shipped register map. Raises ConfigError.
    """
    if "writeback" not in document:
        if "tags" in document and len(_tags(document)):
            _tags(document)[-1].add(tomlkit.nl())
        document["writeback"] = tomlkit.table()
    table: Any = document["writeback"]
    for key, value in head.items():
        set_key(table, key, value)
    chosen = BLOCK_FIELDS if names is None and "fields" not in table else names
    if chosen is None:
        return
    if unknown := [name for name in chosen if name not in BLOCK_FIELDS]:
        raise ConfigError(
            [f"--fields: {unknown[0]!r} is no field of the block; give some of {', '.join(BLOCK_FIELDS)}"]
        )
    wanted = [name for name in BLOCK_FIELDS if name in (*chosen, *NEEDED_FIELDS)]
    present = {row["name"]: dict(row) for row in table.get("fields", ())}
    if list(present) == wanted:  # as it is written, with its comments
        return
    known = {row["name"]: row for row in read_toml(template)["writeback"]["fields"]} | present
    fields = tomlkit.array()
    for name in wanted:
        inline = tomlkit.inline_table()
        inline.update(known[name])
        fields.add_line(inline, comment=describe_field(name))
    fields.add_line(indent="")
    table["fields"] = fields
