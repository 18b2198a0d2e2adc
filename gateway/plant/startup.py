"""Opening what the gateway is made of: model, driver, historian, alarms; fails loudly and precisely."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import join
from typing import Any

import structlog

from drivers.driver import Driver, capabilities, open_driver
from drivers.errors import AddressError, DriverError
from drivers.settings import ConfigError
from drivers.tag import Tag
from gateway.machine.alarms import Alarm, Condition, from_plain, new_alarm
from gateway.machine.clock import Clock
from gateway.machine.links import DeviceLink
from gateway.machine.predict import Predictor
from gateway.machine.quality import STALE_PERIODS
from gateway.machine.redundant import Redundant, Rules, Way
from gateway.plant.config import Config
from gateway.store.historian import Historian
from sim.artefacts.model_json import model_hash
from sim.artefacts.store import current, forced, is_store, load, read_model
from sim.checking.proof.verify import verify
from sim.sha.model import Model

DEVICE = "device"
"""The alarm for what the device itself says is wrong with it."""
DRIFT_SINCE = "14d"
"""The span of the historian that a diagnosis is offered for: ten cycles or more of a plant that runs every day."""
REVIEW = "the readings lie beyond 3 sigma of the model too often: look at the sensor, then learn or correct the model"


@dataclass(frozen=True, slots=True)
class LoadedModel:
    """A model, the SHA-256 of its content, and a sentence where it runs although it does not verify.

    `version` is the store's that it was, "" for a model that comes from no store.
    """

    model: Model
    hash: str
    warning: str = ""
    version: str = ""


def load_model(config: Config) -> LoadedModel | None:
    """The configured model; None without one.

    Raises ConfigError when it cannot be read, does not verify, or does not fit the plant.
    """
    path = config.model.path
    return None if path is None else _load(config, path, "model.path")


def load_members(config: Config, first: LoadedModel | None) -> tuple[LoadedModel, ...]:
    """The models that are followed beside the `first` one.

    Raises ConfigError as `load_model` does, and for a model that is given twice.
    """
    paths = config.ensemble.members
    loaded = tuple(_load(config, path, f"ensemble.members[{place}]") for place, path in enumerate(paths))
    known = {} if first is None else {first.hash: "model.path"}
    for place, one in enumerate(loaded):
        key = f"ensemble.members[{place}]"
        other = known.setdefault(one.hash, key)
        if other != key:
            raise ConfigError([f"{config.path}: {key}: is the same model as {other}; give each model once"])
    return loaded


def _load(config: Config, path: Path, key: str) -> LoadedModel:
    """The model at `path`, which the configuration gives under `key`."""
    try:
        version = current(path) if is_store(path) else ""
        model = load(path, version) if version else read_model(path)
        predictor = Predictor(model, config.model.temperature)
        problem, warning = _unverified(config, model, path, key, version)
    except (OSError, ValueError) as error:
        raise ConfigError([f"{config.path}: {key}: {error}"]) from None
    problems = [problem] if problem else []
    if model.temperature != config.model.temperature:
        problems.append(
            f"model.temperature: is {config.model.temperature!r}, and the model at {path} predicts "
            f"{model.temperature!r}; set it to that, or give a model of {config.model.temperature!r}"
        )
    problems += [
        f"{key}: the model reads {name!r}, no tag of {config.map.path}; add the tag or give another model"
        for name in predictor.missing(config.map.by_name)
    ]
    if problems:
        raise ConfigError([f"{config.path}: {problem}" for problem in problems])
    return LoadedModel(model, model_hash(model), warning, version)


def _unverified(config: Config, model: Model, path: Path, key: str, version: str) -> tuple[str, str]:
    """(why the model is not run, what to say when it is run all the same); both empty for a deployable one.

    One that was promoted by force is run, but nothing of it is written to a plant. Raises ArtefactError.
    """
    reason = "; ".join(verify(model).reasons)
    if not reason:
        return "", ""
    force = forced(path, version) if version else None
    if force is None:
        remedy = f"see `decanter model verify {path}`, give another model, or leave {key} out to run without it"
        return f"{key}: the model at {path} is not run, as it does not verify: {reason}; {remedy}", ""
    said = f"the model at {path} does not verify ({reason}); {force.by} promoted it by force: {force.reason}"
    if config.writeback.mode == "armed":
        return f"writeback.mode: is 'armed', and {said}; set it to 'shadow', or promote a model that verifies", said
    return "", said


def make_driver(config: Config, clock: Clock) -> Driver:
    """The device's driver, not yet opened, able to write the block and nothing else; one for all links together.

    Raises ConfigError.
    """
    if len(config.links) == 1:
        return link_driver(config, config.links[0], clock)
    ways = [Way(link.name, link_driver(config, link, clock), _addressed(link)) for link in config.links]
    beat = max(config.scan.period, config.device.heartbeat_period * clock.speed)
    rules = Rules(config.device.switch_after, config.device.return_after, config.map.heartbeat, beat)
    return Redundant(ways, rules, clock.now)


def link_driver(config: Config, link: DeviceLink, clock: Clock) -> Driver:
    """The driver of one link, with the closed write map unless the mode is off. Raises ConfigError.

    In shadow it may be armed later; a link that cannot write is one that reads then.
    """
    block, mode = link.map.writeback, config.writeback.mode
    write_map = block.words if mode != "off" and block is not None else ()
    try:
        try:
            return open_driver(link.map.driver, link.settings, clock=clock.now, write_map=write_map)
        except AddressError:
            if mode == "armed":
                raise
            return open_driver(link.map.driver, link.settings, clock=clock.now)
    except DriverError as error:
        raise ConfigError([f"{link.map.path}: device: {error}"]) from None


def _addressed(link: DeviceLink) -> dict[str, Tag]:
    """All tags of a link by name, the words of its block too."""
    block = link.map.writeback
    return {tag.name: tag for tag in (*link.map.tags, *(block.words if block else ()))}


def make_conditions(config: Config, inputs: tuple[str, ...], *, complains: bool = False) -> dict[str, Condition]:
    """The alarms by name; their bits are those of the block's alarm word.

    A driver that `complains` has an alarm of its own for what its device says.
    """
    a, period = config.alarms, config.scan.period
    tags = config.map.by_name
    conditions = [
        Condition(
            f"over limit {name}",
            name,
            bit=0,
            limit=a.limit,
            deadband=a.deadband,
            on_delay=a.on_delay,
            off_delay=a.off_delay,
            priority=1,
            response=f"{name} is above {a.limit:g} {tags[name].unit}: reduce the load and check the lubrication",
        )
        for name in config.watched
    ]
    if config.model.path is not None:
        conditions += [
            Condition("predicted over limit", config.model.temperature, 1, a.p_limit, a.p_limit / 2, 0.0, a.off_delay),
            Condition("anomaly", config.model.temperature, 2, a.anomaly, a.anomaly / 3, 0.0, a.off_delay, 3),
            Condition("review", config.model.temperature, 5, 0.5, 0.0, 0.0, a.off_delay, 3, REVIEW),
            Condition("drift", config.model.temperature, 3, a.drift_cycles - 0.5, priority=3, response=_offer(config)),
        ]
    bad = Condition("inputs bad", ", ".join(inputs), 4, 0.5, 0.0, STALE_PERIODS * period, 0.0)
    if complains:
        response = "the device or its bus says that something is wrong: see complaints in the status"
        conditions.append(Condition(DEVICE, config.map.name, 6, 0.5, off_delay=a.off_delay, response=response))
    return {condition.name: condition for condition in (*conditions, bad)}


def scans_on_change(config: Config) -> bool:
    """Whether a change that a device tells by itself brings a scan of its own."""
    asked = config.scan.on_change
    return any(capabilities(link.map.driver).speaks for link in config.links) if asked is None else asked


def _offer(config: Config) -> str:
    """What an operator is told when the model drifts: the command that diagnoses the historian's recent cycles."""
    command = ["decanter", "diagnose", "--model", str(config.model.path), "--historian", str(config.historian.path)]
    command += ["--since", DRIFT_SINCE, "--out", str(config.historian.path.parent / "diagnosis")]
    said = f"the model's free run is beyond its limit on {config.alarms.drift_cycles} cycles running"
    return f"{said}; find out what has changed with: {join(command)}"


def restored_alarms(
    conditions: Mapping[str, Condition], historian: Historian, now: float, log: structlog.typing.FilteringBoundLogger
) -> dict[str, Alarm]:
    """The alarms as they were when the gateway last ran; what cannot be read begins as normal, and is logged."""
    saved = loaded(historian, "alarms", log) or (now, {})
    alarms = {name: new_alarm(condition, now) for name, condition in conditions.items()}
    for name, plain in saved[1].items():
        if name in conditions:
            try:
                alarms[name] = from_plain(conditions[name], plain)
            except (KeyError, TypeError, ValueError) as error:
                log.warning("a saved alarm cannot be read and begins as normal", alarm=name, reason=str(error))
    return alarms


def loaded(
    historian: Historian, key: str, log: structlog.typing.FilteringBoundLogger
) -> tuple[float, dict[str, Any]] | None:
    """A saved state of the historian, or None, logged, where it cannot be read."""
    try:
        found = historian.load(key)
    except ValueError as error:
        log.warning("a saved state cannot be read and is not used", state=key, reason=str(error))
        return None
    return found if found is not None and isinstance(found[1], dict) else None
