"""Several files are replaced in one step: all are new, or, after a kill or a power cut at any moment, all as they were.

What stood in their places is renamed and not copied, so that it comes back with its owner, its mode and its time of
change, by which the words of a plant file are judged. A journal beside the plant file has the renames, in their order,
before the first is done, and is locked while its program runs. Whoever is about to read the plant file, or to replace
it, and finds a journal that nobody holds takes its renames back first (`settle`); so do databases with theirs
(sqlite.org/atomiccommit.html).
"""

import fcntl
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.errors import OneLineError
from drivers.named_files import contents, place_of, writing
from sim.files import sync_directory

Renames = Sequence[tuple[Path, Path]]
"""From and to, in their order."""
PATIENCE_S = 5.0
"""The longest wait for a replacement that is under way; it takes some renames."""
_LOOK_S = 0.02
_MODE = 0o644
_OTHERS_WRITE = 0o022
_MOST_BYTES = 16 << 20


class ReplacementError(OneLineError, OSError):
    """Files were replaced in part and cannot be put back; the message is one sentence that says what would be right."""


def journal_of(plant: Path) -> Path:
    """Where the journal of a plant's files is while they are replaced."""
    place = place_of(plant)
    return place.with_name(f".{place.name}.replacing")


@contextmanager
def replaced(plant: Path, drafts: Mapping[Path, Path], aside: Renames) -> Iterator[None]:
    """Have the renames `aside` done, then each draft (by its place) in its place; to be looked at in the body.

    They stay so once the body has ended; where it raises, and where it is killed, all is as it was, and the drafts are
    what they were (`settle` removes those of who was killed). What is in the way of `aside` is for the caller to remove
    beforehand. Raises OSError, ReplacementError where another replacement is under way.
    """
    settle(plant)
    journal = journal_of(plant)
    done = False
    holder = _written(journal, drafts, aside)
    try:
        # One after the other on the disk too: a draft that came first would be over what is to be put back.
        _rename(aside)
        _rename([(draft, place) for place, draft in drafts.items()])
        yield
        done = True
    finally:
        try:
            if not done:
                _put_back(drafts, aside)
            _remove(journal)
        finally:
            os.close(holder)


def settle(plant: Path, patience: float = PATIENCE_S) -> None:
    """Put all files back as they were, where a replacement was broken off; wait for one that is under way.

    Raises ReplacementError where that cannot be done.
    """
    journal = journal_of(plant)
    deadline = time.monotonic() + patience
    while (holder := _opened(journal)) is not None:
        try:
            with suppress(BlockingIOError):
                fcntl.flock(holder, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _settle(journal, holder)
                return
        finally:
            os.close(holder)
        if time.monotonic() >= deadline:
            raise ReplacementError(f"{plant}: is being replaced by another program ({journal}); try again after that")
        time.sleep(_LOOK_S)


def _opened(journal: Path) -> int | None:
    try:
        return os.open(journal, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _not_back(journal, error.strerror or str(error)) from None


def _settle(journal: Path, holder: int) -> None:
    """Take back what the journal has that is locked as `holder`. Raises ReplacementError."""
    status = os.fstat(holder)
    if not status.st_nlink:
        return  # it is over, and the files are those of one who has carried it out
    if status.st_uid not in {0, os.geteuid()} or status.st_mode & _OTHERS_WRITE:
        # Its renames go to any place: it is believed as far as whoever has written it could have done them alone.
        raise _not_back(journal, f"it is of user {status.st_uid}, who is to do it")
    try:
        plain = json.loads(contents(journal, _MOST_BYTES))
        aside = [(Path(place), Path(after)) for place, after in plain["aside"]]
        drafts = {Path(place): Path(draft) for place, draft in plain["drafts"]}
    except (ValueError, KeyError, TypeError, RecursionError):
        raise _not_back(journal, "it is damaged; compare the files with a backup, and remove it") from None
    except OSError as error:
        raise _not_back(journal, error.strerror or str(error)) from None
    try:
        _put_back(drafts, aside)
        _remove(journal)
        # Behind it: while the journal is there, a draft that is missing is one that was put in place.
        for draft in drafts.values():
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise _not_back(journal, f"{error.filename}: {error.strerror or error}") from None


def _not_back(journal: Path, why: str) -> ReplacementError:
    return ReplacementError(
        f"{journal}: a replacement of the plant's files was broken off, and they cannot be put back ({why}); run "
        "`decanter plc check` as a user who may write them"
    )


def _written(journal: Path, drafts: Mapping[Path, Path], aside: Renames) -> int:
    """Write the journal, on the disk and locked when it gets its name; gives the descriptor that holds it."""
    rows: dict[str, Iterable[tuple[Path, Path]]] = {"aside": aside, "drafts": drafts.items()}
    plain = {name: [list(map(str, pair)) for pair in pairs] for name, pairs in rows.items()}
    draft = journal.with_name(f"{journal.name}.{os.getpid()}")
    draft.unlink(missing_ok=True)
    with writing(draft):
        holder = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, _MODE)
        named = False
        try:
            fcntl.flock(holder, fcntl.LOCK_EX)
            data = json.dumps(plain).encode()
            while data:
                data = data[os.write(holder, data) :]
            os.fsync(holder)
            os.link(draft, journal)  # fails where another one is there, which a rename does not
            named = True
            draft.unlink()
            sync_directory(journal.parent)
        except BaseException:
            os.close(holder)
            draft.unlink(missing_ok=True)
            if named:
                _remove(journal)
            raise
    return holder


def _rename(renames: Renames) -> None:
    for before, after in renames:
        before.rename(after)
    _sync(renames)


def _put_back(drafts: Mapping[Path, Path], aside: Renames) -> None:
    """Have in all places what was there; also a second time, after it was broken off itself."""
    former = {place for place, _ in aside}
    for place, after in aside:
        if _is_there(after):
            after.replace(place)
    for place, draft in drafts.items():
        if place not in former and not _is_there(draft):
            place.unlink(missing_ok=True)
    _sync([*aside, *drafts.items()])


def _remove(journal: Path) -> None:
    journal.unlink()
    sync_directory(journal.parent)


def _is_there(path: Path) -> bool:
    return path.is_symlink() or path.exists()


def _sync(renames: Renames) -> None:
    for folder in dict.fromkeys(place.parent for pair in renames for place in pair):
        sync_directory(folder)
