"""`finding.json` of a version that a diagnosis proposed: what was missing, and the experiment that would confirm it."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sim.files import file_error, read_text
from sim.strict_json import json_text

FINDING_FILE = "finding.json"
FORMAT, VERSION = "decanter-finding", 1


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundEffect:
    """An effect that a diagnosis added: its kind's `name`, its `members` where the data cannot tell them apart, what it
    is in words (`plain`), and the `experiment` that would tell it from its twins."""

    name: str
    members: tuple[str, ...]
    plain: str
    experiment: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisFinding:
    """What a diagnosis of the version `diagnosed` found, with the free-run errors of the held-out cycles in `unit`."""

    diagnosed: str
    effects: tuple[FoundEffect, ...]
    before: float
    after: float
    floor: float
    unit: str

    def plain(self) -> dict[str, Any]:
        """As JSON carries it, without the file's head."""
        return asdict(self)

    def text(self) -> str:
        """The file's content."""
        return json_text({"format": FORMAT, "version": VERSION, **self.plain()}, indent=1) + "\n"


def read_finding(folder: Path) -> DiagnosisFinding | None:
    """That of the version in `folder`; None where it has none. Raises ArtefactError for one that cannot be used."""
    file = folder / FINDING_FILE
    if not file.is_file():
        return None
    text = read_text(file)
    try:
        document: dict[str, Any] = json.loads(text)
        if document.pop("format") != FORMAT or document.pop("version") != VERSION:
            raise ValueError("it is of another format")
        effects = tuple(
            FoundEffect(
                name=str(each["name"]),
                members=tuple(map(str, each["members"])),
                plain=str(each["plain"]),
                experiment=str(each["experiment"]),
            )
            for each in document.pop("effects")
        )
        return DiagnosisFinding(
            diagnosed=str(document["diagnosed"]),
            effects=effects,
            before=float(document["before"]),
            after=float(document["after"]),
            floor=float(document["floor"]),
            unit=str(document["unit"]),
        )
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise file_error(
            file, None, f"cannot be used as a finding ({str(error)[:80]}); restore it from a backup"
        ) from None
