"""The study of a search: an Optuna study in one SQLite file, written by one process, refused where it is another's.

Only this process writes, and SQLite's transactions keep the file whole whenever it is killed. A trial that was running
then stays marked as running; the next start counts it as interrupted and asks for the same settings again, since what
is suggested depends on the seed, the number of finished trials, and their scores.

Optuna and its database layer are the optional extra `tune`, so they are imported where they are needed: `open_study`
says in one sentence that it is missing.
"""

import signal
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from importlib.util import find_spec
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from sim.files import held_alone
from sim.lab.tuning.methods import Choice, Parameter, Real, Value, Whole

if TYPE_CHECKING:
    from optuna.study import Study
    from optuna.trial import FrozenTrial, Trial

NAME = "decanter"
FACTS_KEY = "facts"
REASON_KEY = "reason"
"""Why a trial failed: what it says to whoever looks at the study."""
WITHOUT_OPTUNA = "tuning needs Optuna, which is not installed; install the extra: pip install 'decanter-gateway[tune]'"
MIN_TRIALS_TO_PRUNE = 5
"""Whole trials before one may be pruned, and random ones before the search models their scores, times two."""

Search = Literal["tpe", "grid", "evolutionary"]
"""How settings are suggested: by the tree-structured Parzen estimator (Bergstra et al. 2011), from a grid in random
order, or by crossing and changing the best (NSGA-II, of one objective: Deb et al. 2002)."""
SEARCHES: tuple[Search, ...] = ("tpe", "grid", "evolutionary")
GRID_LEVELS = 3
"""Values of each number in a grid: its bounds and its middle."""

Facts = Mapping[str, str | int | bool]
"""What a study is about, fact by fact: it may only be gone on with where all of them are the same."""


@contextmanager
def unbroken() -> Iterator[None]:
    """Control-C waits until the block ends: raised in the midst of a transaction it would leave the file locked.

    For a block that takes milliseconds. Outside the main thread, where no signal arrives, there is nothing to do.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _frame: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if pressed:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def open_study(file: Path, facts: Facts, *, prune: bool) -> Iterator["Study"]:
    """The study in `file`, made where there is none, held by this process alone until the block ends.

    Raises ValueError without Optuna, where another process holds the study, where the file is no study of this
    project, and where it is about something else.
    """
    if find_spec("optuna") is None:
        raise ValueError(WITHOUT_OPTUNA)
    import optuna
    from optuna.storages import RDBStorage
    from sqlalchemy.engine import URL
    from sqlalchemy.exc import DatabaseError

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pruner = optuna.pruners.MedianPruner(MIN_TRIALS_TO_PRUNE) if prune else optuna.pruners.NopPruner()
    file.parent.mkdir(parents=True, exist_ok=True)
    _check_file(file)
    busy = ValueError(f"{file}: another process is working on this study; wait for it or give another --study file")
    with held_alone(file.with_name(file.name + ".lock"), busy):
        with unbroken():
            try:
                storage = RDBStorage(str(URL.create("sqlite", database=str(file))))
            except DatabaseError as error:
                reason = f"cannot be used as a study ({error.orig}); give another --study file"
                raise ValueError(f"{file}: {reason}") from None
        try:
            with unbroken():
                study = optuna.create_study(storage=storage, study_name=NAME, pruner=pruner, load_if_exists=True)
                _check_facts(file, study, facts)
                interrupt(study)
            yield study
        finally:
            storage.remove_session()
            storage.engine.dispose()


def _check_file(file: Path) -> None:
    """Refuse any other file before a table is made in it. An empty file is taken as a new study."""
    if not file.exists() or (file.is_file() and file.stat().st_size == 0):
        return
    try:
        with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
            tables = database.execute("SELECT COUNT(*) FROM sqlite_master WHERE name = 'studies'").fetchone()[0]
    except sqlite3.DatabaseError as error:
        raise ValueError(f"{file}: is no study ({error}); give the file of a study, or one that is not there") from None
    if not tables:
        raise ValueError(f"{file}: is a database, but no study; give the file of a study, or one that is not there")


def _check_facts(file: Path, study: "Study", facts: Facts) -> None:
    if FACTS_KEY not in study.user_attrs:
        if study.trials:
            raise ValueError(f"{file}: is a study that was not made by this command; give another --study file")
        study.set_user_attr(FACTS_KEY, dict(facts))
        return
    # Studies of earlier releases know one kind of search.
    before = {"search": "tpe", **study.user_attrs[FACTS_KEY]}
    other = [name for name in facts if before.get(name) != facts[name]]
    if other:
        texts = [str(source.get(other[0], "not there")) for source in (before, facts)]
        was, now = (text if len(text) <= 60 else f"{text[:57]}..." for text in texts)
        raise ValueError(
            f"{file}: is a study of another {' and another '.join(other)} ({other[0]}: {was} then, {now} now); its "
            "trials cannot be compared with new ones: take the old settings, or another --study file"
        )


@unbroken()
def interrupt(study: "Study") -> int:
    """Ends the trials that were running, as failed without a reason; how many."""
    from optuna.trial import TrialState

    running = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
    for trial in running:
        study.tell(trial.number, state=TrialState.FAIL)
    return len(running)


@unbroken()
def finished_trials(study: "Study") -> list["FrozenTrial"]:
    """The trials that are over, by number; interrupted ones, which failed without a reason, are not among them."""
    from optuna.trial import TrialState

    over = [trial for trial in study.get_trials(deepcopy=False) if trial.state.is_finished()]
    return [trial for trial in over if trial.state != TrialState.FAIL or REASON_KEY in trial.user_attrs]


@unbroken()
def ask(study: "Study", space: Sequence[Parameter], place: int, seed: int, search: Search = "tpe") -> "Trial":
    """The trial at `place` (0 is the first of the study). The first one has no parameters: the method's defaults.

    The sampler is begun anew for each trial with a seed of its own: so a study that was interrupted goes on as if it
    had not been.
    """
    from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
    from optuna.samplers import BaseSampler, NSGAIISampler, TPESampler

    distributions: dict[str, BaseDistribution] = {}
    for parameter in space if place else ():
        if isinstance(parameter, Real):
            distributions[parameter.name] = FloatDistribution(parameter.low, parameter.high, log=parameter.log)
        elif isinstance(parameter, Whole):
            distributions[parameter.name] = IntDistribution(parameter.low, parameter.high)
        else:
            distributions[parameter.name] = CategoricalDistribution(parameter.options)

    class Evolution(NSGAIISampler):
        """Crosses whole settings: Optuna would leave out what trial 0, which has none, does not share."""

        def infer_relative_search_space(self, *_: object) -> dict[str, BaseDistribution]:
            return distributions

    class Grid(BaseSampler):
        """The grid's points in an order of the seed."""

        def infer_relative_search_space(self, *_: object) -> dict[str, BaseDistribution]:
            return distributions

        def sample_relative(self, *_: object) -> dict[str, Value]:
            return grid_point(space, place - 1, seed)

        def sample_independent(self, *_: object) -> Value:
            raise AssertionError("a point of the grid has all parameters")

    # Of the pair, not of the sum: trial 1 of seed 0 must not be trial 0 of seed 1.
    own = int(np.random.SeedSequence([seed, place]).generate_state(1)[0])
    if search == "evolutionary" and place:
        study.sampler = Evolution(population_size=2 * MIN_TRIALS_TO_PRUNE, seed=own)
    elif search == "grid":
        study.sampler = Grid()
    else:
        study.sampler = TPESampler(seed=own, n_startup_trials=2 * MIN_TRIALS_TO_PRUNE)
    return study.ask(distributions)


def grid_size(space: Sequence[Parameter]) -> int:
    """How many points the grid has."""
    return prod(len(_levels(parameter)) for parameter in space)


def grid_point(space: Sequence[Parameter], number: int, seed: int) -> dict[str, Value]:
    """The point of the grid that is tried as the `number`-th (from 0), by the seed's order."""
    levels = [_levels(parameter) for parameter in space]
    order = np.random.default_rng(seed).permutation(grid_size(space))
    places = np.unravel_index(order[number], [len(each) for each in levels])
    return {parameter.name: own[int(at)] for parameter, own, at in zip(space, levels, places, strict=True)}


def _levels(parameter: Parameter) -> list[Value]:
    if isinstance(parameter, Choice):
        return list(parameter.options)
    ends = (parameter.low, parameter.high, GRID_LEVELS)
    if isinstance(parameter, Whole):
        return [*dict.fromkeys(np.linspace(*ends).round().astype(int).tolist())]
    return [float(level) for level in (np.geomspace(*ends) if parameter.log else np.linspace(*ends))]
