"""A list of hashes that seals the files of a folder, in the form of `sha256sum`; its last line is the seal.

The seal is the SHA-256 of the lines before it. A changed byte in any file, in the list or in the seal shows in
`verify_seal`, and `sha256sum --check` reads the list too. Someone who makes everything anew gets another seal: the one
that counts is printed when the files are made, and belongs beside the signatures.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from drivers.named_files import name_write_errors

_LINE = re.compile(r"([0-9a-f]{64})  ([^\n]+)")
_SEAL = re.compile(r"# seal ([0-9a-f]{64})")


@dataclass(frozen=True, slots=True)
class SealedFile:
    """A file of a sealed folder and what is wrong with it; an empty `problem` is a file as it was made."""

    file: str
    problem: str

    @property
    def ok(self) -> bool:
        """Whether it is as it was made."""
        return not self.problem


def seal_files(folder: Path, list_name: str, names: Iterable[str]) -> str:
    """Write the list of the files `names` (relative to `folder`) as the file `list_name`; gives the seal.

    Raises OSError where a file cannot be read or the list cannot be written.
    """
    lines = _lines({name: sha256((folder / name).read_bytes()).hexdigest() for name in names})
    seal = sha256(lines.encode()).hexdigest()
    with name_write_errors(folder / list_name):
        (folder / list_name).write_text(f"{lines}# seal {seal}\n", encoding="utf-8")
    return seal


def verify_seal(
    folder: Path, list_name: str, seal: str = "", required: Iterable[str] = ()
) -> tuple[str, list[SealedFile]]:
    """The seal of the list, and each file of it and of the `required` ones; the list itself comes last.

    With `seal`, the one that was signed must be the same. Raises OSError where there is no list, ValueError where it
    cannot be read at all.
    """
    path = folder / list_name
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
    # The required files and those of the list: neither a file nor its line can be taken out unseen.
    for name in dict.fromkeys((*required, *listed)):
        file = folder / name
        if name not in listed:
            problem = "is not in the list of hashes"
        elif not file.is_file():
            problem = "is missing"
        else:
            problem = "" if sha256(file.read_bytes()).hexdigest() == listed[name] else "was changed"
        rows.append(SealedFile(name, problem))
    own = sha256(_lines(listed).encode()).hexdigest()
    problem = "" if own == sealed[1] else "its seal is not that of its lines: the list was changed"
    if not problem and seal and not own.startswith(seal.lower()):
        problem = "its seal is another one than was signed: all of it was made anew"
    return own, [*rows, SealedFile(list_name, problem)]


def _lines(digests: Mapping[str, str]) -> str:
    return "".join(f"{digest}  {name}\n" for name, digest in digests.items())
