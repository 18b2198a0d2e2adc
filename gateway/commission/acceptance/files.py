"""The acceptance report's files: JSON, page, paper, the records themselves, and the list of hashes that seals them.

The list has the form of `sha256sum`, and its last line is the SHA-256 of the lines before it: the seal. A changed byte
in any file, in the list or in the seal shows in `verify`. Someone who makes everything anew gets another seal: the one
that counts is printed when the report is made, stands in the audit log, and belongs beside the signatures.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from drivers.named_files import name_write_errors
from gateway.commission.acceptance.blocks import Block, blocks
from gateway.commission.acceptance.paper import paper
from gateway.store import sha256_hex
from sim.lab.pages import page_environment
from sim.strict_json import json_text

JSON, HTML, PDF, RECORDS, LIST = "report.json", "report.html", "report.pdf", "records.jsonl", "report.sha256"
FILES = (JSON, HTML, PDF, RECORDS)
_LINE = re.compile(r"([0-9a-f]{64})  ([^/\n]+)")
_SEAL = re.compile(r"# seal ([0-9a-f]{64})")


def write(folder: Path, data: Mapping[str, Any], records: bytes) -> str:
    """Write all files of the report; gives the seal. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    content = (json_text(data, indent=1) + "\n").encode()
    digest = sha256_hex(content)
    report, title = blocks(json.loads(content), digest), f"Site acceptance report: {data['site']}"
    footer = f"{title}    data SHA-256 {digest}"
    files = {
        JSON: content,
        HTML: page(report, title).encode(),
        PDF: paper(report, title, footer, data["made"]["time"]),
        RECORDS: records,
    }
    for name, bytes_ in files.items():
        with name_write_errors(folder / name):
            (folder / name).write_bytes(bytes_)
    lines = "".join(f"{sha256_hex(bytes_)}  {name}\n" for name, bytes_ in files.items())
    seal = sha256_hex(lines.encode())
    with name_write_errors(folder / LIST):
        (folder / LIST).write_text(f"{lines}# seal {seal}\n", encoding="utf-8")
    return seal


def page(made: Sequence[Block], title: str) -> str:
    """The blocks as one HTML page that needs nothing else; every text in it is escaped."""
    plain = [
        {"kind": type(block).__name__, **{field.name: getattr(block, field.name) for field in fields(block)}}
        for block in made
    ]
    template = page_environment("gateway.commission.acceptance").get_template("report.html.j2")
    return template.render(blocks=plain, title=title)


def verify(folder: Path, seal: str = "") -> tuple[str, list[dict[str, Any]]]:
    """The report's seal, and for each file whether it is as it was made (`ok`, `problem`).

    With `seal`, the one that was signed must be the same. Raises OSError where there is no report, ValueError where the
    list cannot be read at all.
    """
    path = folder / LIST
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is no list of hashes; it was changed") from None
    # Lines of hashes, the seal's, and nothing after the last line break: no byte of the list is left unlooked at.
    *lines, last, rest = (*text.split("\n"),) if "\n" in text else ("", text, "")
    sealed, matches = _SEAL.fullmatch(last), [_LINE.fullmatch(line) for line in lines]
    if rest or sealed is None or not all(matches):
        raise ValueError(f"{path}: is not as a report's list of hashes is made; it was changed")
    listed = {match[2]: match[1] for match in matches if match}
    rows = []
    # The files of every report and those of the list: neither a file nor its line can be taken out unseen.
    for name in dict.fromkeys((*FILES, *listed)):
        file = folder / name
        if name not in listed:
            problem = "is not in the list of hashes"
        elif not file.is_file():
            problem = "is missing"
        else:
            problem = "" if sha256_hex(file.read_bytes()) == listed[name] else "was changed"
        rows.append({"file": name, "ok": not problem, "problem": problem})
    own = sha256_hex("".join(f"{digest}  {name}\n" for name, digest in listed.items()).encode())
    problem = "" if own == sealed[1] else "its seal is not that of its lines: the list was changed"
    if not problem and seal and not own.startswith(seal.lower()):
        problem = "its seal is another one than was signed: all of it was made anew"
    return own, [*rows, {"file": LIST, "ok": not problem, "problem": problem}]
