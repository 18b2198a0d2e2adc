"""The judge of a plant file: what a gateway that started with it now would refuse, go without, or do to no use.

Asked by every command that says of a plant file that it is in order, so that none says it of what another refuses.
What `load_plant` refuses comes before: here are the files, ports, models and limits that it names. Nothing is written,
and the device is not asked.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from drivers.connections import Connections
from drivers.errors import DriverError
from drivers.settings import ConfigError, with_place
from drivers.survey import read_plan
from gateway.machine.model import LoadedModels, ModelsAtStart, models_at_start
from gateway.machine.reading import plant_clock
from gateway.outside.status import connect
from gateway.plant.device import make_driver
from gateway.plant.shared_connections import connection_groups
from gateway.plant.shortfalls import of_plant
from gateway.settings import Config
from gateway.store import SQLITE_HEADER, SigningKeyError, load_key
from sim.sha import RELAXING_FLOWS, distributions
from sim.units import display_unit

MAX_SOCKET_BYTES = 107
"""What Linux keeps of a socket's path (`sun_path`, less its end)."""
_HERE = ("127.0.0.1", "localhost", "::1")
_LISTENS_HERE = (*_HERE, "0.0.0.0", "::")  # noqa: S104 (looked for, not listened on)
MAX_REACH_SPANS = 2.0
"""A limit so many times the model's span of temperatures above the hottest of them never comes within reach."""


@dataclass(frozen=True, slots=True)
class PlantFinding:
    """What is wrong, in a sentence; `machine` is "" for what the whole plant has once.

    `part` is what is touched: "device", "places", "model", "limits", "records", "ports", "page", "messages",
    "northbound". Not `grave` is what runs and is worth a look.
    """

    part: str
    sentence: str
    machine: str = ""
    grave: bool = True


def check_plant(
    configs: Sequence[Config], known: Mapping[str, ModelsAtStart] | None = None
) -> tuple[PlantFinding, ...]:
    """All that is wrong with a plant file that could be loaded, the gravest first; none if it is in order.

    `known` are machines' models that have been read already, by the machines' names.
    """
    known = known or {}
    found = [*_devices(configs)]
    for config in configs:
        found += check_machine(config, known[config.machine] if config.machine in known else models_at_start(config))
    found += _labels(configs)
    return tuple(sorted([*found, *check_common(configs[0])], key=lambda finding: not finding.grave))


def _labels(configs: Sequence[Config]) -> Iterator[PlantFinding]:
    """Words of the page for what is not there."""
    config = configs[0]
    known = {config.machine for config in configs} | {
        name for config in configs for link in config.links for name in (*link.map.by_name, *link.map.derived)
    }
    for name in sorted(config.page.labels.keys() - known):
        said = f"{config.path}: page.labels: {name!r} is no machine and no tag of this plant; spell it as there"
        yield PlantFinding("page", said, grave=False)


def check_machine(config: Config, models: ModelsAtStart) -> list[PlantFinding]:
    """What is wrong with a machine's models and limits."""
    loaded, problem = models
    found = [PlantFinding("model", problem, config.machine)] if problem else []
    found += [PlantFinding("model", said, config.machine, grave=False) for said in unfit_models(config, loaded)]
    found += [PlantFinding("ports", said, config.machine) for said in _ports_of_the_device(config)]
    return found + [PlantFinding("limits", said, config.machine, grave=False) for said in limit_doubts(config, loaded)]


def check_common(config: Config) -> list[PlantFinding]:
    """What is wrong with what all machines have in common: page, messages, sinks, records, ports."""
    found = [PlantFinding(part, sentence) for part, sentence in of_plant(config).items()]
    return [*found, *_records(config), *_ports(config)]


def _devices(configs: Sequence[Config]) -> Iterator[PlantFinding]:
    """Drivers that cannot be made, and places that cannot be read as they are given."""
    clock, connections, said = plant_clock(1.0), Connections(), set[str]()
    for group in connection_groups(configs):
        for config in group:
            try:
                make_driver(config, clock, connections if config.several else None)
            except ConfigError as error:
                yield from (PlantFinding("device", problem, config.machine) for problem in error.problems)
                continue
            for link in config.links:
                try:
                    words = link.map.block_words if config.writeback.mode != "off" else ()
                    plan = read_plan(link.map.driver, link.settings, link.map.tags, words)
                    problems = () if plan is None else (*plan.problems, *plan.overlaps)
                except DriverError as error:
                    problems = (str(error),)
                for problem in problems:
                    sentence = f"{link.map.path}: {problem}"
                    # Machines of one device file have its slips in common.
                    if sentence not in said:
                        said.add(sentence)
                        yield PlantFinding("places", sentence, config.machine)


def _records(config: Config) -> Iterator[PlantFinding]:
    """Files that the gateway would write and this user cannot, or that are something else."""
    own: dict[str, Callable[[Path], str]] = {
        "historian.path": _no_database,
        "writeback.audit": _no_database,
        "writeback.audit_key": _no_key,
        "control.path": _no_socket,
    }
    for key, path in config.written_files.items():
        reason, grave = _unwritable(path)
        if not reason and key != "control.path" and path.exists() and not path.is_file():
            reason = "is no file; give the path of one"
        if key == "control.path" and len(os.fsencode(path)) > MAX_SOCKET_BYTES:
            reason, grave = f"is longer than the {MAX_SOCKET_BYTES} bytes that a socket's path may have; give one", True
        if not reason and key in own and path.exists():
            reason = own[key](path)
        if reason:
            yield PlantFinding("records", f"{config.path}: {key}: {path} {reason}", grave=grave)


def _unwritable(path: Path) -> tuple[str, bool]:
    """Why this user cannot have a file there ("": it can), and whether nobody could.

    Who runs the gateway may be somebody else, as the service's own user is.
    """
    another = "does another user run this?"
    try:
        if path.is_dir():
            return "is a folder; give the path of a file", True
        if path.exists():
            mine = os.access(path, os.R_OK | os.W_OK)
            return "" if mine else f"may not be written by this user; {another}", mine
        parent = next(place for place in path.absolute().parents if os.path.lexists(place))
        if not parent.is_dir():
            what = "a link that leads nowhere" if parent.is_symlink() and not parent.exists() else "no folder"
            return f"cannot be: {parent} is {what}; give the path of a file in a folder", True
        if os.statvfs(parent).f_flag & os.ST_RDONLY:
            return f"cannot be made: {parent} is on a read-only file system; give another place", True
        mine = os.access(parent, os.W_OK | os.X_OK)
        return "" if mine else f"may not be made by this user in {parent}; {another}", mine
    except PermissionError:
        return f"may not be looked at by this user; {another}", False
    except OSError as error:
        return f"cannot be looked at ({error.strerror}); give another place", True


def _no_socket(path: Path) -> str:
    return "" if path.is_socket() else "is a file that is no socket; give a path of its own"


def _no_key(path: Path) -> str:
    try:
        load_key(path)
    except SigningKeyError as error:
        return str(error).removeprefix(f"{path}: ")
    return ""


def _no_database(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(len(SQLITE_HEADER))
    return "" if head in (b"", SQLITE_HEADER) else "is no database; give the path of a historian or of a new file"


def _ports(config: Config) -> Iterator[PlantFinding]:
    """Ports that others have, or two of these servers; not where a gateway runs by this very file: it has them."""
    if _has_gateway(config.control_socket):
        return
    with ExitStack() as listening:
        for key, (host, port) in _served(config).items():
            try:
                # Kept until all are tried: two of these servers may want the same.
                listening.enter_context(_listener(host, port))
            except UnicodeError:
                yield PlantFinding("ports", f"{config.path}: {key}: {host!r} is no host's name")
            except OSError as error:
                reason = error.strerror or str(error)
                said = f"{config.path}: {key}: cannot listen at {host}:{port} ({reason})"
                # A service may have the right to a port below 1024 that this user has not.
                yield PlantFinding("ports", said, grave=not isinstance(error, PermissionError))


def _served(config: Config) -> dict[str, tuple[str, int]]:
    """(host, port) of what the gateway serves, by the keys that name the ports."""
    northbound = config.northbound
    named = {
        "page.port": (config.page.host, config.page.port if config.page.enabled else None),
        "serve.port": (config.serve.host, config.serve.port),
        "northbound.metrics.port": (northbound.metrics.host, northbound.metrics.port),
        "northbound.opcua.port": (northbound.opcua.host, northbound.opcua.port),
    }
    return {key: (host, port) for key, (host, port) in named.items() if port}


def _ports_of_the_device(config: Config) -> Iterator[str]:
    """Ports at which the gateway would ask itself for its device."""
    for link in config.links:
        if not {"host", "port"} <= link.settings.keys():
            continue
        try:
            device = with_place(link.settings)
        except ValueError:
            continue  # its driver cannot be made, and says why
        for key, (host, port) in _served(config).items():
            # A server that listens everywhere listens here too.
            here = device["host"] in _HERE and host in _LISTENS_HERE
            if device["port"] == port and (here or device["host"] == host):
                yield (
                    f"{config.path}: {key}: {port} is the port of the device at {device['host']}, so that the "
                    "gateway would ask itself; give another"
                )


def _has_gateway(path: Path) -> bool:
    """Whether a gateway answers at the socket, or one is there that this user may not ask."""
    if (line := connect(path)) is not None:
        line.close()
        return True
    try:
        return path.exists() and not os.access(path, os.W_OK)
    except PermissionError:
        return True


def _listener(host: str, port: int) -> socket.socket:
    """A socket that listens there, as the servers' do. Raises OSError or UnicodeError."""
    family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind)
    try:
        # What merely waits for its last packets is no obstacle.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listener.bind(address)
        listener.listen(1)
    except BaseException:
        listener.close()
        raise
    return listener


def unfit_models(config: Config, models: Sequence[LoadedModels]) -> Iterator[str]:
    """The models that were judged unfit where they were learned, those of an ensemble too; a sentence each."""
    for one, (first, members) in zip(config.temperature_configs, models, strict=True):
        for loaded in (first, *members):
            if loaded is not None and loaded.verdict is not None and loaded.verdict.word == "unfit":
                name = f"{loaded.model.sha.name} ({loaded.hash[:12]})"
                yield f"{config.path}: {name}, a model of {one.model.temperature}, is {loaded.verdict.sentence}"


def limit_doubts(config: Config, models: Sequence[LoadedModels]) -> Iterator[str]:
    """Limits that no reading could pass or that every reading passes: by what the device file takes for plausible, and
    by what the `models` of the machine's temperatures lead to. One sentence each."""
    yield from _limits_of_tags(config)
    yield from _limits_of_models(config, models)


def _limits_of_tags(config: Config) -> Iterator[str]:
    for name in config.watched_temperatures:
        tag, limit = config.map.by_name[name], config.find_limit(name)
        unit = display_unit(tag.unit)
        said = f"{config.path}: the limit of {name}, {limit:g} {unit},"
        if tag.high is not None and limit >= tag.high:
            yield f"{said} can never be passed: the device file takes readings above {tag.high:g} for wrong"
        elif tag.low is not None and limit <= tag.low:
            yield f"{said} is passed by every reading: the device file takes those below {tag.low:g} for wrong"
        elif tag.low is not None and limit - config.alarms.deadband <= tag.low:
            yield f"{said} has a deadband of {config.alarms.deadband:g}: no plausible reading would end the alarm"


def _limits_of_models(config: Config, models: Sequence[LoadedModels]) -> Iterator[str]:
    for one, (loaded, _) in zip(config.temperature_configs, models, strict=True):
        if loaded is None:
            continue
        model, limit = loaded.model, one.alarms.limit
        known = [
            model.correction.gain * distributions.mean(place.distribution) + model.correction.offset
            for place in model.sha.locations
            if place.distribution is not None and place.flow.kind in RELAXING_FLOWS and place.name not in model.borrowed
        ]
        if not known:
            continue
        coldest, hottest, unit = min(known), max(known), display_unit(model.unit)
        said = f"{config.path}: the limit of {one.model.temperature}, {limit:g} {unit},"
        if limit <= coldest:
            yield f"{said} lies below all that the model leads to ({coldest:.0f} to {hottest:.0f}): it always stands"
        elif hottest > coldest and limit - one.alarms.deadband <= coldest:
            yield f"{said} has a deadband of {one.alarms.deadband:g}: below {coldest:.0f} the model never leads"
        elif hottest > coldest and limit > hottest + MAX_REACH_SPANS * (hottest - coldest):
            yield (
                f"{said} never comes within reach: the model leads to {coldest:.0f} to {hottest:.0f}; it would "
                "warn of nothing"
            )
