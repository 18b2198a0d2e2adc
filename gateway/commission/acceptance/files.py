"""The acceptance report's files: JSON, page, paper, the records themselves, and the list of hashes that seals them.

The seal is printed when the report is made, and stands in the audit log.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from drivers.named_files import name_write_errors
from gateway.commission.acceptance.blocks import Block, blocks
from gateway.commission.acceptance.paper import paper
from gateway.store import sha256_hex
from sim.lab.pages import page_environment
from sim.sealed_files import SealedFile, seal_files, verify_seal
from sim.strict_json import json_text

JSON, HTML, PDF, RECORDS, LIST = "report.json", "report.html", "report.pdf", "records.jsonl", "report.sha256"
FILES = (JSON, HTML, PDF, RECORDS)


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
    return seal_files(folder, LIST, FILES)


def page(made: Sequence[Block], title: str) -> str:
    """The blocks as one HTML page that needs nothing else; every text in it is escaped."""
    plain = [
        {"kind": type(block).__name__, **{field.name: getattr(block, field.name) for field in fields(block)}}
        for block in made
    ]
    template = page_environment("gateway.commission.acceptance").get_template("report.html.j2")
    return template.render(blocks=plain, title=title)


def verify(folder: Path, seal: str = "") -> tuple[str, list[SealedFile]]:
    """The report's seal, and each of its files. Raises as `verify_seal`."""
    return verify_seal(folder, LIST, seal, FILES)
