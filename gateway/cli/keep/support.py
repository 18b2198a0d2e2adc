"""`decanter keep support`: what somebody elsewhere needs to understand a gateway, in one file without a secret."""

import json
import sqlite3
import time
import tomllib
import zipfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict
from importlib.metadata import distributions
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import tomlkit

from drivers.errors import OneLineError
from drivers.settings import ConfigError
from gateway.cli.keep.masking import make_mask, mask_values, written_forms
from gateway.clock_sync import clock_error
from gateway.commission.session import versions
from gateway.console import CommandResult, conclude
from gateway.entry import sentences
from gateway.outside.status import ControlError, connect, findings, judge_health, read_status
from gateway.outside.web import box_facts
from gateway.plant import configuration_files, history_folder, kept_configurations
from gateway.settings import Config, load_plant
from gateway.store import numbered_files, verify, write_durably
from sim.strict_json import json_text

LOG_LINES = 5000
JOURNAL_S = 30 * 86_400.0
ANSWER_S = 10.0
MIN_SECRET_PIECE_LENGTH = 8
"""Characters of a piece of an address, or a line of a key, that is looked for by itself: shorter ones are words."""
_ABOUT = """\
What a gateway is and how it does, made by `decanter keep support`.

versions.json      program, Python, system, packages
configuration/     plant file and device files, without their comments; history.json: when they were taken over
status.json        the running gateway, machine by machine, and what its checks find
log.jsonl          the end of the log
alarms.json        what alarms did in the last 30 days
records.json       historian and audit log: sizes, layouts, newest scan, whether the chain is unbroken
box.json           disk, memory, load, clock

Masked: passwords, tokens, addresses of web hooks beyond the host, whatever is called so or is in a file of secrets.
Never in it: keys, certificates, accounts, the files of secrets, readings, models.
"""


class LeakError(OneLineError, ValueError):
    """A secret is in the bundle; nothing is written."""


def support(path: Path, file: Path | None, as_json: bool) -> None:
    """The work of `keep support`."""
    with sentences():
        now = time.time()
        file = file or Path(f"decanter-support-{time.strftime('%Y%m%d-%H%M%S', time.gmtime(now))}.zip")
        if file.exists():
            raise ValueError(f"{file}: is there already; give another name")
        members = bundle(path, now)
        packed = BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in members.items():
                archive.writestr(zipfile.ZipInfo(name, time.gmtime(now)[:6]), text, zipfile.ZIP_DEFLATED)
        write_durably(file, packed.getvalue(), mode=0o600)
    data = {"file": str(file), "members": list(members), "bytes": len(packed.getvalue())}
    sentence = (
        f"{file}: {len(members)} files, {len(packed.getvalue()) / 1e3:.0f} kB; look through it before you send it"
    )
    conclude(CommandResult(data), lambda _: [sentence], as_json=as_json)


def bundle(path: Path, now: float) -> dict[str, str]:
    """The texts of the bundle by their names. Raises LeakError rather than let a known secret out."""
    problem, machines = "", tuple[Config, ...]()
    try:
        machines = load_plant(path)
    except ConfigError as error:
        problem = str(error)
    known = _known_secrets(path, machines)
    mask = make_mask(known)
    sources: dict[str, Callable[[], Any]] = {"versions.json": _versions}
    if machines:
        first = machines[0]
        sources |= {
            "configuration/history.json": lambda: _history(first),
            "status.json": lambda: _status(machines),
            "alarms.json": lambda: _journal(first, now),
            "records.json": lambda: _records(first, now),
            "box.json": lambda: {**box_facts(first), "synchronised": _has_clock_sync()},
        }
    members = {"README.txt": _ABOUT}
    if problem:
        members["problem.txt"] = mask(problem)
    files = configuration_files(machines) if machines else [("plant", path)]
    for number, (_, file) in enumerate(files):
        name = file.name if number == 0 else f"{number}-{file.name}"
        members[f"configuration/{name}"] = _configuration(file, mask)
    for name, make in sources.items():
        members[name] = json_text(mask_values(_or_reason(make), mask)) + "\n"
    if machines and machines[0].log.path is not None:
        members["log.jsonl"] = "".join(_log_lines(machines[0].log.path, mask))
    for name, text in members.items():
        # It is our own text that a password of one word may be in.
        for secret in known if name != "README.txt" else ():
            if any(form in text for form in written_forms(secret)):
                raise LeakError(f"a secret was found in {name} of the bundle, and nothing is written: report this")
    return members


def _or_reason(make: Callable[[], Any]) -> Any:
    """What is made, or why it cannot be."""
    try:
        return make()
    except (OSError, ValueError, sqlite3.Error) as error:
        return {"not to be had": str(error)}


def _configuration(file: Path, mask: Callable[[str], str]) -> str:
    """A file of the configuration; of TOML what it says without its comments, in which anything may stand."""
    try:
        text = file.read_bytes().decode(errors="replace")
    except OSError as error:
        return f"not to be had: {error}\n"
    if file.suffix != ".toml":
        return mask(text)
    try:
        plain: Mapping[str, Any] = mask_values(tomllib.loads(text), mask)
    except tomllib.TOMLDecodeError as error:
        return f"not to be had: it is no TOML ({error}), and what in it is a secret cannot be told\n"
    return tomlkit.dumps(plain)


def _versions() -> dict[str, Any]:
    packages = {dist.metadata["Name"]: dist.version for dist in distributions()}
    system = dict[str, str]()
    with suppress(OSError):
        lines = Path("/etc/os-release").read_text(encoding="utf-8").splitlines()
        system = {key: value.strip('"') for key, _, value in (line.partition("=") for line in lines) if value}
    return {"program": packages.get("decanter-gateway", ""), **versions(()), "os": system, "packages": packages}


def _history(config: Config) -> list[dict[str, Any]]:
    kept = kept_configurations(history_folder(config))
    return [
        {
            "number": one.number,
            "time": one.manifest.made,
            "note": one.manifest.note,
            "program": one.manifest.program,
            "files": {file.original: file.sha256 for file in one.manifest.files},
        }
        for one in kept
    ]


def _status(machines: Sequence[Config]) -> dict[str, Any]:
    """How every machine is by the running gateway's own word, and what is found wrong."""
    if (line := connect(machines[0].control_socket, ANSWER_S)) is None:
        return {"not to be had": f"no gateway answers at {machines[0].control_socket}"}
    with closing(line):
        try:
            answers = line.ask("plant")["statuses"]
        except ControlError as error:
            return {"not to be had": str(error)}
    found = {}
    for name, plain in answers.items():
        status = read_status(plain)
        sentences_of = {finding.check: finding.sentence for finding in findings(status)}
        found[name] = {"health": judge_health(status), "findings": sentences_of, "status": plain}
    return found


def _journal(config: Config, now: float) -> list[dict[str, Any]]:
    from gateway.machine.alarms import read_journal  # with `reading` below all that loads numpy

    return [asdict(row) for row in read_journal(config.historian.path, start=now - JOURNAL_S)]


def _records(config: Config, now: float) -> dict[str, Any]:
    def historian() -> dict[str, Any]:
        from gateway.store import reading

        path = config.historian.path
        with reading(path) as connection:
            layout, pages, free = (
                int(connection.execute(f"PRAGMA {name}").fetchone()[0])
                for name in ("user_version", "page_count", "freelist_count")
            )
            newest = connection.execute("SELECT max(time) FROM scans").fetchone()[0]
        beside = {file.name: file.stat().st_size for file in sorted(path.parent.glob(f"{path.name}*"))}
        age = None if newest is None else now - newest
        return {
            "path": str(path),
            "layout": layout,
            "pages": pages,
            "free": free,
            "age_of_newest_scan": age,
            "files": beside,
        }

    def audit() -> dict[str, Any]:
        verdict = verify(config.audit)
        return {"path": str(config.audit), "rows": verdict.rows, "head": verdict.head, "problem": verdict.problem}

    return {"historian": _or_reason(historian), "audit": _or_reason(audit)}


def _has_clock_sync() -> bool | None:
    error = clock_error()
    return None if error is None else isfinite(error)


def _log_lines(path: Path, mask: Callable[[str], str]) -> Iterator[str]:
    """The last lines of the log, those of older files too."""
    lines = deque[str](maxlen=LOG_LINES)
    for file in numbered_files(path):
        with suppress(OSError), file.open(encoding="utf-8", errors="replace") as stream:
            lines.extend(stream)
    for line in lines:
        try:
            yield json.dumps(mask_values(json.loads(line), mask), ensure_ascii=False) + "\n"
        except ValueError:  # the end of a file that was cut
            yield mask(line)


# ---------------------------------------------------------------- what is known to be secret


def _known_secrets(path: Path, machines: Sequence[Config]) -> set[str]:
    """Every secret that the gateway's own files hold, as far as they can be read."""
    found = set(_secret_texts(_toml(path)))
    for config in machines[:1]:
        for secrets in filter(None, (config.notify.secrets, config.northbound.secrets)):
            found |= set(_secret_texts(_toml(secrets), everything=True))
    # Of an address the host may be known; what in it is a secret may stand alone, too.
    for address in [text for text in found if "://" in text]:
        found.discard(address)
        with suppress(ValueError):
            parts = urlsplit(address)
            pieces = (*parts.path.split("/"), *(value for _, value in parse_qsl(parts.query)), parts.password or "")
            found |= {piece for piece in pieces if len(piece) >= MIN_SECRET_PIECE_LENGTH}
    for config in machines[:1]:
        with suppress(OSError, ValueError):
            accounts = json.loads(config.users.read_text(encoding="utf-8"))["accounts"]
            found |= {str(account["password"]) for account in accounts.values()}
    for key in _key_files(machines):
        with suppress(OSError, UnicodeDecodeError):
            found |= {line for line in key.read_text(encoding="ascii").split() if len(line) >= MIN_SECRET_PIECE_LENGTH}
    return found


def _key_files(machines: Sequence[Config]) -> Iterator[Path]:
    folders = [config.page.certificates for config in machines]
    folders += [config.northbound.opcua.certificates for config in machines]
    folders += [
        Path(str(each)) for one in machines for link in one.links if (each := link.settings.get("certificates"))
    ]
    for folder in filter(None, dict.fromkeys(folders)):
        yield from sorted(folder.glob("*.key"))
    for config in machines[:1]:
        yield from filter(None, (getattr(row, "key", None) for row in config.northbound.sinks))
        yield config.audit_key


def _toml(path: Path) -> Mapping[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def _secret_texts(value: Any, *, everything: bool = False) -> Iterator[str]:
    """The texts in a table that are masked there: all of them in a file of secrets."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if not isinstance(inner, str):
                yield from _secret_texts(inner, everything=everything)
            elif everything or mask_values({key: inner}, make_mask(()))[key] != inner:
                yield inner
    elif isinstance(value, list):
        for inner in value:
            yield from _secret_texts({"": inner} if isinstance(inner, str) else inner, everything=everything)
