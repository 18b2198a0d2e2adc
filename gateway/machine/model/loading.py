"""A model before it runs: read from where the configuration says, verified, held against the plant's tags."""

from dataclasses import dataclass
from pathlib import Path

from drivers.settings import ConfigError
from gateway.machine.model.predict import Predictor
from gateway.settings import Config
from sim.artefacts import (
    MODEL_FILE,
    Familiarity,
    ModelVerdict,
    current,
    find_force,
    is_store,
    load,
    model_hash,
    read_familiarity,
    read_model,
    read_verdict,
    version_directory,
)
from sim.effects import of_machine
from sim.proof import verify
from sim.sha import Model


@dataclass(frozen=True, slots=True)
class LoadedModel:
    """A model, the SHA-256 of its content, and a sentence where it runs although it does not verify.

    `version` is the store's that it was, "" for a model that comes from no store; `file` holds it, `written` when that
    was (s UTC).
    `familiarity` is what its training was like, `verdict` whether it may be used; None where that is not known.
    """

    model: Model
    hash: str
    warning: str = ""
    version: str = ""
    written: float | None = None
    familiarity: Familiarity | None = None
    file: Path | None = None
    verdict: ModelVerdict | None = None


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
    for place, member in enumerate(loaded):
        key = f"ensemble.members[{place}]"
        other = known.setdefault(member.hash, key)
        if other != key:
            raise ConfigError([f"{config.path}: {key}: is the same model as {other}; give each model once"])
    return loaded


LoadedModels = tuple[LoadedModel | None, tuple[LoadedModel, ...]]
"""The model of a followed temperature (None without one), and those of an ensemble beside it."""


def load_models(config: Config) -> tuple[LoadedModels, ...]:
    """The models of each of a machine's temperatures, in their order. Raises ConfigError as `load_model` does."""
    loaded = ((one, load_model(one)) for one in config.temperature_configs)
    return tuple((model, load_members(one, model)) for one, model in loaded)


ModelsAtStart = tuple[tuple[LoadedModels, ...], str]
"""The models of each of a machine's temperatures as far as they can be run, and why others cannot ("": all can)."""


def models_at_start(config: Config) -> ModelsAtStart:
    """The models of each of a machine's temperatures as far as they can be run, and why others cannot ("": all can).

    What has befallen a model's files keeps no machine from being watched: it runs without that model.
    """
    found, problems = list[LoadedModels](), list[str]()
    for one in config.temperature_configs:
        model, members = None, tuple[LoadedModel, ...]()
        try:
            model = load_model(one)
            members = load_members(one, model)
        except ConfigError as error:
            problems += error.problems
        found.append((model, members))
    return tuple(found), "; ".join(dict.fromkeys(problems))


def _load(config: Config, path: Path, key: str) -> LoadedModel:
    """The model at `path`, which the configuration gives under `key`."""
    try:
        version = current(path) if is_store(path) else ""
        model = _own(config, load(path, version) if version else read_model(path))
        home = version_directory(path, version) if version else path
        file = home / MODEL_FILE if home.is_dir() else home
        written = file.stat().st_mtime
        familiarity = read_familiarity(home) if home.is_dir() else None
        verdict = read_verdict(home) if home.is_dir() else None
        predictor = Predictor(model, config.model.temperature)
        problem, warning = _verify_model(config, model, path, key, version)
    except (OSError, ValueError) as error:
        raise ConfigError([f"{config.path}: {key}: {error}"]) from None
    # From here on all that is wrong is collected, so that one start tells of everything.
    problems = [problem] if problem else []
    if model.temperature != config.model.temperature:
        problems.append(
            f"model.temperature: is {config.model.temperature!r}, and the model at {path} predicts "
            f"{model.temperature!r}; set it to that, or give a model of {config.model.temperature!r}"
        )
    if config.scan.period > model.alphabet.gap:
        problems.append(
            f"scan.period: {config.scan.period:g} s is longer than {model.alphabet.gap:g} s, for which the model at "
            f"{path} holds a reading at most, so that it would never foresee; scan at least so often, or give a model "
            "that was learned from rows of this interval"
        )
    problems += [
        f"{key}: the model reads {name!r}, no tag of {config.map.path}; add the tag or give another model"
        for name in predictor.missing_inputs(config.map.by_name)
    ]
    if problems:
        raise ConfigError([f"{config.path}: {problem}" for problem in problems])
    return LoadedModel(
        model,
        model_hash(model),
        warning,
        version=version,
        written=written,
        familiarity=familiarity,
        file=file,
        verdict=verdict,
    )


def _own(config: Config, model: Model) -> Model:
    """The model with what it knows of this machine, where it is one of a type of machine. Raises ValueError."""
    wanted = config.model.correction
    if wanted and wanted not in model.machines:
        known = ", ".join(sorted(model.machines)) or "none"
        raise ValueError(
            f"correction: the model knows no machine {wanted!r}, only {known}; give one of these, or leave the key out"
        )
    name = config.machine if wanted is None else wanted
    return of_machine(model, name) if name in model.machines else model


def _verify_model(config: Config, model: Model, path: Path, key: str, version: str) -> tuple[str, str]:
    """(why the model is not run, what to say when it is run all the same); both empty for a deployable one.

    One that was promoted by force is run, but nothing of it is written to a plant. Raises ArtefactError.
    """
    reason = "; ".join(verify(model).reasons)
    if not reason:
        return "", ""
    force = find_force(path, version) if version else None
    if force is None:
        remedy = f"see `decanter model judge proof {path}`, give another model, or leave {key} out to run without it"
        return f"{key}: the model at {path} is not run, as it does not verify: {reason}; {remedy}", ""
    sentence = f"the model at {path} does not verify ({reason}); {force.by} promoted it by force: {force.reason}"
    if config.writeback.mode == "armed":
        return (
            f"writeback.mode: is 'armed', and {sentence}; set it to 'shadow', or promote a model that verifies",
            sentence,
        )
    return "", sentence
