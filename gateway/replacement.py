"""Several files are replaced in one step: all are new, or, after a kill or a power cut at any moment, all as they were.

Whoever replaces files locks the folder of the plant file first, by flock(2), which ends with its program. What stood in
their places is renamed and not copied, so that it comes back with its owner, its mode and its time of change, by which
the words of a plant file are judged. A journal beside the plant file has the renames, in their order, before the first
is done. Whoever is about to read the plant file, or to replace it, and finds a journal takes the lock, and its renames
back (`settle`); so do databases with theirs (sqlite.org/atomiccommit.html).
"""

import fcntl
import json
import os
import pwd
import re
import stat
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.errors import OneLineError
from drivers.named_files import name_write_errors, normal_path
from sim.files import sync_directory

Renames = Sequence[tuple[Path, Path]]
"""From and to, in their order."""
PATIENCE_S = 5.0
"""The longest wait for a replacement that is under way; it takes some renames."""
_LOOK_S = 0.02
_MODE = 0o1644
"""Of a journal and no other file: its owner alone can have given it the sticky bit, which no copy of ours has."""
_MOST_BYTES = 16 << 20
_REPLACED = re.compile(r"(.+)\.replaced-\d+(-wal|-shm|-journal)?", re.DOTALL)


class ReplacementError(OneLineError, OSError):
    """Files are being replaced, or were in part and cannot be put back; one sentence that says what would be right."""


def journal_path(plant: Path) -> Path:
    """Where the journal of a plant's files is while they are replaced."""
    place = normal_path(plant)
    return place.with_name(f".{place.name}.replacing")


def draft_path(place: Path) -> Path:
    """Where what is to be in a place is written beforehand."""
    return place.with_name(f".{place.name}.replacement")


def former_path(place: Path) -> Path:
    """Where what stood in a place is until its replacement is over."""
    return place.with_name(f".{place.name}.former")


def files_version(plant: Path) -> tuple[int, ...]:
    """What is another after files were replaced, or put back; () where that cannot be told."""
    place = normal_path(plant)
    with suppress(OSError):
        return place.stat().st_ino, place.parent.stat().st_mtime_ns
    return ()


def has_newer_files(plant: Path, before: tuple[int, ...]) -> bool:
    """Whether files were replaced since the version `before`, or are being replaced: what was read is of two times."""
    return os.path.lexists(journal_path(plant)) or files_version(plant) != before


@contextmanager
def hold_folder(plant: Path, patience: float = PATIENCE_S) -> Iterator[None]:
    """Be the only one who replaces files of this plant's folder; what was broken off is put back before.

    All that depends on which files are there, and each draft, belongs into the body. Raises ReplacementError, also
    where another program has not ended with it within `patience` (s).
    """
    folder = normal_path(plant).parent
    deadline = time.monotonic() + patience
    try:
        holder = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        why = error.strerror or str(error)
        raise ReplacementError(f"{folder}: cannot be locked ({why}); run it as a user who may read it") from None
    try:
        while not _try_lock(holder):
            if time.monotonic() >= deadline:
                raise ReplacementError(f"{plant}: is being replaced by another program; try again after that")
            time.sleep(_LOOK_S)
        _settle(journal_path(plant))
        yield
    finally:
        os.close(holder)


def write_draft(place: Path, data: bytes, mode: int, owner: tuple[int, int] | None = None) -> None:
    """Write what is to be in a place, within `hold_folder`; one of who was killed is in nobody's way. Raises OSError.

    It is of `owner` (user, group) as far as this user may give files away.
    """
    draft = draft_path(place)
    draft.unlink(missing_ok=True)
    # Never through a link that somebody has put there.
    file = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with name_write_errors(draft), os.fdopen(file, "wb") as stream:
        if owner is not None:
            with suppress(PermissionError):
                os.fchown(file, *owner)
        os.fchmod(file, mode)
        stream.write(data)
        stream.flush()
        os.fsync(file)


@contextmanager
def replace_files(plant: Path, places: Collection[Path], aside: Renames) -> Iterator[None]:
    """Within `hold_folder`: have the renames `aside` done, then each place's draft put there; looked at in the body.

    They stay so once the body has ended. Where it raises, and where it is killed, all places are as they were, and the
    drafts that were in them are gone (`settle` removes all those of who was killed). What is in the way of `aside` is
    for the caller to remove beforehand. Raises OSError.
    """
    journal = journal_path(plant)
    done = False
    try:
        _write(journal, places, aside)
        # One after the other on the disk too: a draft that came first would be over what is to be put back.
        _rename(aside)
        _rename([(draft_path(place), place) for place in places])
        yield
        done = True
    finally:
        if not done:
            _restore(places, aside)
        journal.unlink(missing_ok=True)
        sync_directory(journal.parent)


def settle(plant: Path, patience: float = PATIENCE_S) -> None:
    """Put all files back as they were, where a replacement was broken off; wait for one that is under way.

    Raises ReplacementError where that cannot be done.
    """
    # Whoever may not look there is told so when the plant file is read.
    if os.path.lexists(journal_path(plant)):
        with hold_folder(plant, patience):
            pass


def _try_lock(holder: int) -> bool:
    try:
        fcntl.flock(holder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _settle(journal: Path) -> None:
    """Take back what a journal has, the lock being held. Raises ReplacementError."""
    try:
        if (found := _read(journal)) is None:
            return
        places, aside = found
        _restore(places, aside)
        journal.unlink()
        sync_directory(journal.parent)
        # Behind it: while the journal is there, a draft that is missing is one that was put in place.
        for place in places:
            draft_path(place).unlink(missing_ok=True)
    except ReplacementError:
        raise
    except OSError as error:
        why = f"{error.filename}: {error.strerror or error}"
        raise ReplacementError(
            f"{journal}: a replacement of the plant's files was broken off, and this user cannot put them back "
            f"({why}); run `decanter plc check` as a user who may write them"
        ) from None


def _read(journal: Path) -> tuple[list[Path], list[tuple[Path, Path]]] | None:
    """The places and renames of a journal; None without one. Raises ReplacementError, OSError.

    It is believed as far as whoever has written it could have done its renames alone: the owner of the folder can give
    this name to any file there.
    """
    try:
        # Neither through a link nor waiting for the other end of a pipe.
        holder = os.open(journal, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _no_journal(journal, error.strerror or str(error)) from None
    try:
        status = os.fstat(holder)
        if not stat.S_ISREG(status.st_mode) or stat.S_IMODE(status.st_mode) != _MODE:
            raise _no_journal(journal, f"it is no file of mode {_MODE:o}")
        if status.st_uid not in {0, os.geteuid()}:
            who = _user_name(status.st_uid)
            raise ReplacementError(
                f"{journal}: a replacement of the plant's files by {who} was broken off, and is taken back by nobody "
                f"else; run `sudo -u {who} decanter plc check`"
            )
        with os.fdopen(os.dup(holder), "rb") as stream:
            plain = json.loads(stream.read(_MOST_BYTES))
        places = [Path(place) for place in plain["places"]]
        aside = [(Path(place), Path(after)) for place, after in plain["aside"]]
        if not (all(place.is_absolute() for place in places) and all(_is_ours(*pair) for pair in aside)):
            raise _no_journal(journal, "it has renames that no replacement does")
    except (ValueError, KeyError, TypeError, RecursionError):
        raise _no_journal(journal, "it is damaged") from None
    finally:
        os.close(holder)
    return places, aside


def _user_name(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"'#{user}'"  # as sudo has it


def _no_journal(journal: Path, why: str) -> ReplacementError:
    return ReplacementError(
        f"{journal}: is not as a replacement of the plant's files leaves it ({why}); compare the files with a backup, "
        "and remove it"
    )


def _is_ours(place: Path, after: Path) -> bool:
    """Whether a replacement sets a place aside so."""
    found = _REPLACED.fullmatch(after.name)
    named_so = after == former_path(place) or (found is not None and found[1] + (found[2] or "") == place.name)
    return named_so and place.is_absolute() and after.parent == place.parent


def _write(journal: Path, places: Iterable[Path], aside: Renames) -> None:
    """Write the journal, which is on the disk when it gets its name."""
    plain = {"places": list(map(str, places)), "aside": [list(map(str, pair)) for pair in aside]}
    try:
        write_draft(journal, json.dumps(plain).encode(), _MODE)
        draft_path(journal).rename(journal)
    finally:
        draft_path(journal).unlink(missing_ok=True)
    sync_directory(journal.parent)


def _rename(renames: Renames) -> None:
    for before, after in renames:
        before.rename(after)
    _sync(before.parent for before, _ in renames)


def _restore(places: Collection[Path], aside: Renames) -> None:
    """Have in all places what was there; also a second time, after it was broken off itself."""
    former = {place for place, _ in aside}
    for place, after in aside:
        if _is_there(after):
            after.replace(place)
    for place in places:
        if place not in former and not _is_there(draft_path(place)):
            place.unlink(missing_ok=True)
    _sync(place.parent for place in (*former, *places))


def _is_there(path: Path) -> bool:
    """Whether anything has that name. Raises OSError where that cannot be looked at."""
    try:
        path.lstat()
    except FileNotFoundError:
        return False
    return True


def _sync(folders: Iterable[Path]) -> None:
    for folder in dict.fromkeys(folders):
        sync_directory(folder)
