"""`decanter keep backup` and `decanter keep restore`: all that a gateway is, as one folder, and back from it."""

import time
import tomllib
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from drivers.named_files import MOST_TOML_BYTES, name_write_errors, normal_path
from gateway.commission.session import login
from gateway.commission.writeback.block_writer import gateway_runs
from gateway.console import CommandResult, Part, conclude
from gateway.entry import sentences
from gateway.machine.writing import own_process
from gateway.plant import configuration_files, require_named_places, without_arming
from gateway.replacement import hold_folder
from gateway.settings import Config, load_plant
from gateway.store import (
    DAMAGED_AUDIT,
    DISARMED,
    AuditEntry,
    BackupError,
    Manifest,
    SigningKeyError,
    WitnessPlaces,
    armed_subjects,
    as_one_file,
    discard,
    heads_file,
    load_key,
    load_public_key,
    make_backup,
    open_audit,
    public_digits,
    public_path,
    put_in_place,
    read_manifest,
    sign_head,
    signer,
    stage,
)


def backup(path: Path, folder: Path, as_json: bool) -> None:
    """The work of `keep backup`."""
    with sentences():
        machines = load_plant(path)
        key, unsigned = _held_key(machines[0])
        manifest = make_backup(
            folder, list_sources(machines), now=time.time(), program=version("decanter-gateway"), key=key
        )
    size = sum(file.size for file in manifest.files)
    data = {
        "folder": str(folder),
        "files": len(manifest.files),
        "bytes": size,
        "audit_head": manifest.audit_head,
        "seal": manifest.seal,
        "signed": key is not None,
        "damaged": manifest.damaged,
    }
    head = f"; audit log whole, {manifest.audit_rows} rows, head {manifest.audit_head}" if manifest.audit_head else ""
    if manifest.damaged:
        head = f"; THE AUDIT LOG IS DAMAGED, and in the backup as it is: {manifest.damaged}"
    signed = "signed by the gateway's key" if key is not None else f"not signed ({unsigned})"

    def show() -> Iterator[Part]:
        yield f"{folder}: {len(manifest.files)} files, {size / 1e6:.1f} MB{head}"
        yield f"seal {manifest.seal}, {signed}; keep the seal elsewhere: it vouches for the backup without a key"

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def _held_key(config: Config) -> tuple[Ed25519PrivateKey | None, str]:
    """The gateway's key if this user can sign with it, else why not. A backup is never kept from being made by it."""
    if not config.audit_key.exists():
        return None, f"there is no key {config.audit_key} yet"
    try:
        return load_key(config.audit_key), ""
    except SigningKeyError as error:
        return None, str(error)


def list_sources(machines: Sequence[Config]) -> list[tuple[str, Path]]:
    """Every file of a gateway with what it is to it, in the order in which they are copied."""
    config = machines[0]
    rows = configuration_files(machines)
    predicted = [row.model for machine in machines for row in machine.temperatures]
    for model in (*predicted, *(member for machine in machines for member in machine.ensemble.members)):
        if model is not None:
            rows += [("model", file) for file in _model_files(model)]
    # Machines of one type share files.
    rows = list(dict.fromkeys(rows))
    key = config.audit_key
    rows += [("accounts", config.users)] if config.users.exists() else []
    rows += [(role, file) for role, file in (("key", key), ("public key", public_path(key))) if file.exists()]
    # A witness before what it bears witness to: the audit log in the backup holds every head that is in the backup.
    last = (("heads", config.audit_heads), ("historian", config.historian.path), ("audit", config.audit))
    rows += [(role, file) for role, file in last if file.exists()]
    unique = {normal_path(file): (role, file) for role, file in rows}
    return list(unique.values())


def _model_files(model: Path) -> Iterator[Path]:
    """The files of a model or store; which version is current comes before the versions, none of which ever changes."""
    if not model.is_dir():
        yield model
        return
    files = [file for file in model.rglob("*") if file.is_file() and not file.name.startswith(".")]
    yield from sorted(files, key=lambda file: (len(file.relative_to(model).parts), file))


def restore(
    folder: Path, into: Path, overwrite: bool, by: str, seal: str, public_key: Path | None, as_json: bool
) -> None:
    """The work of `keep restore`."""
    with sentences():
        manifest, into = read_manifest(folder), into.absolute()
        _require_own_places(folder, manifest)
        _require_voucher(folder, manifest, into, seal, public_key)
        places = {Path(file.original): into / Path(file.original).relative_to("/") for file in manifest.files}
        roles = {file.role: places[Path(file.original)] for file in manifest.files}
        roles["plant"].parent.mkdir(parents=True, exist_ok=True)
        with hold_folder(roles["plant"]):
            if "historian" in roles and gateway_runs(roles["historian"]):
                raise BackupError(f"{roles['historian']}: a gateway runs on it; stop it first")
            standing = [place for place in places.values() if place.exists()]
            if standing and not overwrite:
                more = f" and {len(standing) - 1} others are" if len(standing) > 1 else " is"
                raise BackupError(f"{standing[0]}{more} there already; nothing is overwritten without --overwrite")
            drafts = stage(folder, manifest, into)
            placed = False
            try:
                said = _disarm(manifest, {role: drafts[place] for role, place in roles.items()}, by or login())
                # Beside a damaged log that is restored none stays (`damaged_audit`): an arming in it would be in force.
                away = [copy.with_suffix("")] if (copy := roles.get(DAMAGED_AUDIT)) is not None else []
                aside = put_in_place(roles["plant"], drafts, away=away)
                placed = True
            finally:
                if not placed:
                    discard(drafts)
    data = {"folder": str(folder), "files": [str(place) for place in drafts], "aside": [str(p) for p in aside]}

    def show() -> Iterator[Part]:
        yield f"{len(drafts)} files are restored, as of {time.strftime('%F %T UTC', time.gmtime(manifest.made))}"
        for place in aside:
            yield f"set aside: {place}"
        yield said
        if manifest.damaged:
            yield f"THE AUDIT LOG IN IT IS DAMAGED: {manifest.damaged}"

    data["damaged"] = manifest.damaged
    complaint = ""
    if roles.get("plant") is not None:
        try:
            load_plant(roles["plant"])
        except ValueError as error:
            complaint = f"the restored plant file names what is not there: {str(error).splitlines()[0]}"
    conclude(CommandResult({**data, "said": said}, complaint), lambda _: show(), as_json=as_json)


def _require_own_places(folder: Path, manifest: Manifest) -> None:
    """Raise BackupError, OSError unless every file of a backup lies where the plant file in it says."""
    plant = next((Path(file.original) for file in manifest.files if file.role == "plant"), None)
    if plant is None:
        raise BackupError(f"{folder}: has no plant file, so it is no gateway's backup; take another one")
    contents = {
        Path(file.original): (folder / file.stored).read_bytes()
        for file in manifest.files
        if file.role == "plant" or (file.role == "device" and file.size <= MOST_TOML_BYTES)
    }
    require_named_places(manifest, plant, contents)


def _require_voucher(folder: Path, manifest: Manifest, into: Path, seal: str, public_key: Path | None) -> None:
    """Raise BackupError unless somebody vouches for a backup; its own seal only shows that it is whole.

    Raises SigningKeyError for a public key that cannot be read.
    """
    if seal:
        if seal.strip().lower() != manifest.seal:
            raise BackupError(f"{folder}: has another seal than {seal!r}; it was changed, or it is another backup")
        return
    by, reasons = signer(folder, manifest), list[str]()
    if public_key is not None:
        if by == load_public_key(public_key):
            return
        reasons.append(f"it is not signed by the key of {public_key}")
    elif not by:
        reasons.append("it is not signed")
    else:
        held = [Path(file.original) for file in manifest.files if file.role == "key"]
        # Restored elsewhere on the same box, it is the key of the gateway that goes on there.
        held = [place for key in held for place in (into / key.relative_to("/"), key) if place.exists()]
        for place in dict.fromkeys(held):
            try:
                if by == public_digits(load_key(place).public_key()):
                    return
                reasons.append(f"it is not signed by the key {place}")
            except SigningKeyError as error:
                reasons.append(str(error))
        reasons = reasons or ["this box holds no key of the gateway to check its signature by"]
    raise BackupError(
        f"{folder}: nobody vouches for it: {'; '.join(reasons)}; give the seal that was kept of it (--seal HASH), or a "
        "copy of the gateway's public key that was kept elsewhere (--public-key FILE)"
    )


def _disarm(manifest: Manifest, drafts: dict[str, Path], by: str) -> str:
    """Take every arming out of the drafts of a restored gateway; gives what it will do. Raises BackupError, OSError."""
    modes = set[str]()
    if (plant := drafts.get("plant")) is not None:
        before = plant.read_bytes()
        after = without_arming(before)
        document = tomllib.loads(after.decode())
        modes = {table.get("writeback", {}).get("mode", "off") for table in (document, *document.get("machine", ()))}
        if after != before:
            modes.add("armed")
            with name_write_errors(plant):
                plant.write_bytes(after)
    if (log := drafts.get("audit")) is not None:
        audit = open_audit(log)
        try:
            reason = f"restored from a backup of {time.strftime('%F %T UTC', time.gmtime(manifest.made))}"
            # Each machine of several is armed by itself, and so is the gateway of one.
            for subject in dict.fromkeys(("", *armed_subjects(log))):
                if not audit.record(AuditEntry(time.time(), DISARMED, by, reason, own_process()).with_subject(subject)):
                    raise BackupError(f"the restored audit log does not take a row: {audit.failure}")
        finally:
            audit.close()
        if "key" in drafts and "heads" in drafts:
            places = WitnessPlaces(audit=log, key=drafts["key"], heads=drafts["heads"])
            sign_head(places.audit, load_key(places.key), time.time(), [lambda head: heads_file(head, places.heads)])
        as_one_file(log)
    if modes <= {"off"}:
        return "the restored gateway computes and writes nothing: its mode is 'off'"
    was = " (it was 'armed')" if "armed" in modes else ""
    return (
        f"the restored gateway starts in mode 'shadow'{was} and writes nothing to the PLC until somebody arms it; rows "
        "of the audit log that are newer than the backup have to be acknowledged as lost then"
    )
