"""What another plant file changes for a gateway that runs, machine by machine and key by key."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

from pydantic import BaseModel

from drivers.settings import ConfigError
from gateway.settings.config import COMMON, COMMON_KEYS, Config


def changed_machines(before: Mapping[str, Config], after: Mapping[str, Config]) -> dict[str, tuple[str, ...]]:
    """The machines that another plant file adds, removes or changes, with what it changes in sentences.

    Whether the file has [[machine]] tables is no change of a machine: one that runs goes on as it is, under the name
    that it has on record until the gateway's next start.

    Raises ConfigError for a change of what all machines have in common, which only a restart takes over, and for a file
    without any machine that goes on.
    """
    first, other = next(iter(before.values())), next(iter(after.values()))
    common = [
        sentence
        for sentence in _differences(first, other)
        if (section := sentence.split(".", 1)[0].split(":", 1)[0]) in COMMON
        or any(sentence.startswith(f"{section}.{key}:") for key in COMMON_KEYS.get(section, ()))
    ]
    if common:
        raise ConfigError([f"{other.path}: {common[0]}: is common to all machines; stop the gateway and start it anew"])
    changes: dict[str, tuple[str, ...]] = {name: ("removed",) for name in before if name not in after}
    for name, config in after.items():
        if name not in before:
            changes[name] = ("added",)
        elif (config := replace(config, several=before[name].several)) != before[name]:
            changes[name] = tuple(_differences(before[name], config)) or tuple(_others(before[name], config))
    return changes


def _differences(before: Config, after: Config) -> Iterator[str]:
    """The keys that differ, as `section.key: old -> new`."""
    for field in fields(Config):
        old, new = getattr(before, field.name), getattr(after, field.name)
        if field.compare and old != new and isinstance(old, BaseModel) and isinstance(new, BaseModel):
            yield from _of_section(field.name, old.model_dump(mode="json"), new.model_dump(mode="json"))
        elif field.name == "leads" and old != new:
            yield f"the alarms of the plant: {'looks' if new else 'no longer looks'} after them"
        elif field.name == "alarm" and old != new:
            yield "alarm: its tables differ"
        elif field.name == "temperatures" and old != new:
            names = [", ".join(row.tag for row in rows) for rows in (old, new)]
            yield f"temperature: {names[0]} -> {names[1]}" if names[0] != names[1] else "temperature: its table differs"


def _others(before: Config, after: Config) -> Iterator[str]:
    """What else differs, where no key of the plant file does."""
    for field in fields(Config):
        if field.compare and getattr(before, field.name) != getattr(after, field.name):
            yield "its device file has changed" if field.name == "links" else f"{field.name}: differs"


def _of_section(name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    for key in dict.fromkeys((*old, *new)):
        if old.get(key) != new.get(key):
            yield f"{name}.{key}: {old.get(key)} -> {new.get(key)}"
