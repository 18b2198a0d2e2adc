"""The index of the decision records, and references to records that are gone: `python -m tests.rig.decision_index`.

A record's first section says its status; the index is made of these. Who writes a number of a record elsewhere writes
one that there is: `dangling` finds the others.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "docs" / "decisions"
INDEX = RECORDS / "index.md"

HEAD = """# Decision records

What binds in this project and could be questioned, made by `python -m tests.rig.decision_index` from the records' own
words. Of several records on one subject one is left: it has the lowest of their numbers, says what holds now, and names
the ones that it takes in. What merely explains how a room does a thing stands on that room's page. Former records are
in the version history.

| record | status | takes in |
|---|---|---|
"""
STATUS = re.compile(r"\*\*Status\.\*\* (Accepted|Superseded by \d{4}|Amends \d{4})\.(?: Takes in ((?:\d{4}(?:, )?)+))?")
SEARCHED = ("benchmarks", "config", "deploy", "docs", "drivers", "gateway", "sim", "tests")
"""Folders whose texts may name a record, beside the files of the project's root."""
SUFFIXES = {".md", ".py", ".toml", ".service", ".j2", ".yml", ".lark", ".js", ".html", ".csv", ""}
NAMED = re.compile(
    r"\b(?:[Rr]ecords?|[Dd]ecisions?)[\s#]+\[?(0[0-5]\d\d(?:(?:, | and )0[0-5]\d\d)*)\b"
    r"|decisions/(\d{4})\b"
    r"|\((0[0-5]\d\d(?:, 0[0-5]\d\d)*)(?=[);,])"
    r"|\[(0[0-5]\d\d)\]"
)
"""How a text names records: `record 0001`, `decisions/0001-...`, `(0001, 0002)`, `and [0001]`."""


@dataclass(frozen=True)
class DecisionRecord:
    """A decision record: its number, its title, its status, and the numbers that it takes in."""

    path: Path
    number: str
    title: str
    status: str
    takes_in: tuple[str, ...]


def records() -> list[DecisionRecord]:
    """All records in the order of their numbers. Raises ValueError for one without a title or a status."""
    return [_record(path) for path in sorted(RECORDS.glob("[0-9]*.md"))]


def _record(path: Path) -> DecisionRecord:
    title, _, rest = path.read_text(encoding="utf-8").partition("\n\n")
    status = STATUS.match(rest.replace("\n", " "))
    number = path.name[:4]
    if status is None or not title.startswith(f"# {number} "):
        raise ValueError(f"{path}: a record begins with '# {number} TITLE' and '**Status.** Accepted.' or what it is")
    taken = tuple(status[2].rstrip(", ").split(", ")) if status[2] else ()
    return DecisionRecord(path, number, title.removeprefix(f"# {number} "), status[1], taken)


def index() -> str:
    """The page that lists all records."""
    return HEAD + "".join(
        f"| [{one.number}]({one.path.name}) {one.title} | {one.status.lower()} | {', '.join(one.takes_in)} |\n"
        for one in records()
    )


def texts() -> Iterator[Path]:
    """The files whose texts may name a record."""
    yield from (path for path in ROOT.iterdir() if path.is_file() and path.suffix == ".md")
    for folder in SEARCHED:
        yield from (path for path in (ROOT / folder).rglob("*") if path.is_file() and path.suffix in SUFFIXES)


def dangling() -> list[str]:
    """Each reference to a record that is not there: its file, its line and the number."""
    there = {one.number for one in records()}
    found = []
    for path in texts():
        if path == INDEX or "__pycache__" in path.parts:
            continue
        text = path.read_text(encoding="utf-8", errors="ignore")
        if path.parent == RECORDS:
            text = STATUS.sub("", text)
        for match in NAMED.finditer(text):
            # In code a number in brackets is a number; in prose it is a record.
            if (match[3] or match[4]) and path.suffix != ".md":
                continue
            line = text.count("\n", 0, match.start()) + 1
            numbers = re.findall(r"\d{4}", next(filter(None, match.groups())))
            found += [f"{path.relative_to(ROOT)}:{line}: {number}" for number in numbers if number not in there]
    return found


def main() -> None:
    """Write the index, and print what refers to a record that is gone; exit code 1 where something does."""
    INDEX.write_text(index(), encoding="utf-8")
    lost = dangling()
    print(*lost, sep="\n")
    sys.exit(1 if lost else 0)


if __name__ == "__main__":
    main()
