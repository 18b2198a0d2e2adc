"""Files that a gateway relies on while it runs: whether each path still leads to what was opened, as it was left there.

A program that has a file open goes on with it when its name is taken away, and writes to what nobody will read. So each
file on which a promise rests (the audit log, its heads and key, the historian and its lock, the page's accounts, the
models in use) is known here, and looked at by `look`: before and after each row of the audit log, so that no block
leaves after something was done to one of them, and with each batch of the historian.
"""

import hashlib
import os
import stat
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from threading import Lock

_PATIENCE_SECONDS = 5.0
_SETTLE_SECONDS = 0.05
"""How long a file whose content is to stay may be half written, by who puts the same there again."""
_WRITABLE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRule:
    """What may become of a file without a word: it `grows`, or is `fixed`, content and all.

    One that grows may be cut back to `most` bytes by its owner. One that is fixed may be replaced by a copy of itself.
    `late`: it may come later. `mapped`: SQLite has it mapped into memory, and a program that looks there beyond its end
    is ended by the kernel. `least` gives the bytes below which its size never falls. `accepts` looks at another file in
    its place, and says why that will not do ("": it will).
    """

    grows: bool = False
    most: float = inf
    fixed: bool = False
    late: bool = False
    mapped: bool = False
    least: Callable[[], int] | None = None
    accepts: Callable[[Path], str] | None = None


GROWS, FIXED, STAYS = FileRule(grows=True), FileRule(fixed=True), FileRule()
"""Only appended to; never written again; written by its owner anywhere in it."""


def database(path: Path, rule: FileRule, wal: FileRule = FileRule(grows=True, late=True)) -> dict[Path, FileRule]:
    """The files of a SQLite database that is open in WAL mode, each with its rule."""
    beside = {"-wal": wal, "-shm": FileRule(grows=True, late=True, mapped=True)}
    return {path: rule, **{path.with_name(path.name + ending): each for ending, each in beside.items()}}


@dataclass(slots=True)
class _ReliedFile:
    """A file as it was seen last; `seen` is None before the first look, `descriptor` holds it in its place then."""

    path: Path
    rule: FileRule
    seen: os.stat_result | None = None
    descriptor: int = -1
    digest: bytes = b""
    largest: int = 0
    was_read_only: bool = False

    def hold(self, read_only: bool) -> str:
        """Take the file that is there now for the one that is relied on; gives why it cannot be. Raises OSError."""
        self.let_go()
        # A path only (open(2), O_PATH): no other file gets its number meanwhile, and closing it takes nobody's locks.
        self.descriptor = os.open(self.path, os.O_PATH | os.O_CLOEXEC)
        now = os.fstat(self.descriptor)
        if not stat.S_ISREG(now.st_mode):
            self.let_go()
            return "is no file"
        self.seen, self.largest, self.was_read_only = now, now.st_size, read_only
        self.digest = _digest(self.path) if self.rule.fixed else b""
        return ""

    def let_go(self) -> None:
        """Hold it no more."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
        self.descriptor = -1


class ReliedFiles:
    """The files that are relied on, in groups by what they are; any thread may watch, forget and look.

    `complaint` says what is wrong with them now, `note` what ever was ("": nothing); `taken` counts how often
    something was begun to be wrong.
    """

    def __init__(self, on_read_only_disk: Callable[[Path], bool] | None = None) -> None:
        self._on_read_only_disk = on_read_only_disk or on_read_only_disk_of_system
        self._groups: dict[str, tuple[_ReliedFile, ...]] = {}
        self._gone: tuple[_ReliedFile, ...] = ()
        self._changing, self._looking = Lock(), Lock()
        self.complaint = self.note = ""
        self.taken = 0

    def watch(self, what: str, files: Mapping[Path, FileRule]) -> None:
        """Rely on these files from the next look on, as they are then, and no more on others of this name."""
        with self._changing:
            former = self._groups.get(what, ())
            self._groups = {**self._groups, what: tuple(_ReliedFile(path, rule) for path, rule in files.items())}
            self._gone += former

    def forget(self, what: str) -> None:
        """Rely on them no more: their owner closes them. No look is under way then, but one that a disk holds up."""
        self.watch(what, {})
        if self._looking.acquire(timeout=_PATIENCE_SECONDS):
            try:
                self._let_go()
            finally:
                self._looking.release()

    def close(self) -> None:
        """Rely on none of them any more."""
        for what in self._groups:
            self.forget(what)

    def knows(self, what: str) -> bool:
        """Whether files of this name are relied on."""
        return bool(self._groups.get(what))

    def look(self, what: str = "") -> str:
        """Look at all of them; gives what is wrong with those of this name, by default with any of them."""
        with self._looking:
            self._let_go()
            found = {name: _first(self._problems(group)) for name, group in self._groups.items()}
            wrong = "; ".join(dict.fromkeys(filter(None, found.values())))
            if wrong and not self.complaint:
                self.taken += 1
            self.complaint, self.note = wrong, self.note or wrong
        return found.get(what, "") if what else wrong

    def tell(self, problem: str) -> None:
        """Take what the owner of a file has found in it that no look from outside tells: it was done to it."""
        with self._looking:
            self.taken += 1
            self.note = self.note or problem

    def _let_go(self) -> None:
        """Hold no more what is relied on no more (no look is under way)."""
        with self._changing:
            gone, self._gone = self._gone, ()
        for file in gone:
            file.let_go()

    def _problems(self, group: Iterable[_ReliedFile]) -> Iterable[str]:
        for file in group:
            if problem := self._file_problem(file):
                yield f"{file.path}: {problem}; put back what it was, or start the gateway anew"

    def _file_problem(self, file: _ReliedFile) -> str:
        try:
            return self._compare_file(file, file.path.stat(), read_only=self._on_read_only_disk(file.path))
        except FileNotFoundError:
            awaited = file.rule.late and file.seen is None
            return "" if awaited else "is gone, as it was removed or renamed while it was in use"
        except OSError as error:
            return f"cannot be looked at while it is in use ({(error.strerror or str(error)).lower()})"

    def _compare_file(self, file: _ReliedFile, now: os.stat_result, *, read_only: bool) -> str:
        before, rule = file.seen, file.rule
        another = before is not None and (now.st_dev, now.st_ino) != (before.st_dev, before.st_ino)
        changed = before is None or another or (now.st_size, now.st_mtime_ns) != (before.st_size, before.st_mtime_ns)
        if rule.accepts is not None and changed and (problem := rule.accepts(file.path)):
            return problem
        if before is None or (another and rule.accepts is not None):
            return file.hold(read_only)
        if changed and rule.fixed:
            same = _digest(file.path) == file.digest
            if not same and not self.complaint:
                time.sleep(_SETTLE_SECONDS)  # perhaps it is being written
                same = _digest(file.path) == file.digest
            if not same:
                return "has another content than what is in use"
            if another and not before.st_mode & ~now.st_mode & _WRITABLE:
                return file.hold(read_only)
        if another and not rule.fixed:
            return "is another file than the one that is in use"
        if before.st_mode & ~now.st_mode & _WRITABLE:
            return "may not be written any more, as its mode was changed while it was in use"
        if read_only and not file.was_read_only:
            return "may not be written any more, as its disk is mounted read-only now"
        return self._size_problem(file, now)

    def _size_problem(self, file: _ReliedFile, now: os.stat_result) -> str:
        rule = file.rule
        least = min(file.largest, rule.most) if rule.grows else rule.least() if rule.least is not None else 0
        if now.st_size < least:
            if rule.mapped:
                # With its former length it ends nobody, and SQLite makes its content anew from the log beside it.
                with suppress(OSError):
                    os.truncate(file.path, file.largest)
            return f"was cut to {now.st_size} bytes while it was in use"
        file.seen, file.largest = now, max(file.largest, now.st_size)
        return ""


def on_read_only_disk_of_system(path: Path) -> bool:
    """Whether the disk that has the path is mounted read-only. Raises OSError."""
    return bool(os.statvfs(path).f_flag & os.ST_RDONLY)


def _digest(path: Path) -> bytes:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()


def _first(problems: Iterable[str]) -> str:
    # All are looked at, as to look mends a file that is mapped.
    return next(iter(list(problems)), "")
