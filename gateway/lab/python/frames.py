"""The laboratory from Python: what its commands do, on plain objects, with pandas data frames in and out.

Each function calls what the command of its name calls. Bad input raises a ValueError of one sentence.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import date
from math import inf, isnan
from pathlib import Path
from tempfile import TemporaryDirectory
from time import time as now
from typing import TYPE_CHECKING, get_args, overload

import numpy as np
import pandas as pd

from drivers.settings import validate_section
from gateway.console import shipped_file
from gateway.entry import sentence
from gateway.lab.checking.simulate import simulate_traces
from gateway.lab.gap.diagnose import DiagnosisRequest, run, signal_roles
from gateway.lab.judging.skill import measure_skill, spread_period
from gateway.lab.learning.learn import TaughtModel, teach_model
from gateway.lab.options import MOST_MOMENTS, Method
from gateway.machine.model import forecast_trace
from gateway.settings import ForecastSection
from sim.engine import Policy, Start
from sim.forecast import FAN_LEVELS
from sim.lab.discrepancy import Diagnosis
from sim.lab.formats import FoundModel, find_model, write_model_directory
from sim.lab.judge import ForecastSkill
from sim.lab.learning.lsha import LshaSettings
from sim.lab.recordings import (
    ColumnMap,
    TraceError,
    channel_uses,
    dated_format,
    is_time,
    list_names,
    load_map,
    load_traces,
    parse_map,
    since_1970,
)
from sim.lab.recordings.mapping import Answers, Undecided, draft_map
from sim.sha import Array, Model, Trace, encode_trace

if TYPE_CHECKING:
    from sim.lab.checking.smc import Answer

Progress = Callable[[str, float], None]
"""Takes what is being done, and the share of the work that is done (0 to 1)."""
Frame = pd.DataFrame
_FRAME = Path("recording") / "frame.csv"
"""What a data frame is called; the folder is the machine of traces that say none."""
_FROM = "the data frame"
_CLOCKS = (pd.DatetimeIndex, pd.PeriodIndex, pd.TimedeltaIndex)
"""What an index without a name is when it is a clock."""
_OPTION = re.compile(r"--([a-z][a-z-]*)")


def _several(name: str, given: object) -> tuple[str, ...]:
    """One text or several. Raises ValueError for what is neither."""
    several = (given,) if isinstance(given, str) else tuple(given) if isinstance(given, pd.Index) else given
    if not isinstance(several, list | tuple) or not all(isinstance(each, str) for each in several):
        raise ValueError(f"{name}={_shown(given)}: give a text, or a list of texts")
    return tuple(filter(None, several))


def _check_choice(name: str, given: object, choices: Sequence[str]) -> None:
    if given not in choices:
        raise ValueError(f"{name}={given!r}: is no answer; give {list_names(map(repr, choices))}")


def _python(given: object) -> object:
    """A NumPy number as Python's own; anything else as it is."""
    return given.item() if isinstance(given, np.generic) else given


def _whole(name: str, given: object, least: int = 0) -> int:
    """The number. Raises ValueError for what is no whole number from `least` on."""
    plain = _python(given)
    if not isinstance(plain, int) or isinstance(plain, bool) or plain < least:
        raise ValueError(f"{name}={plain!r}: give a whole number from {least}")
    return plain


def _number(name: str, given: object) -> float:
    """The number. Raises ValueError for what is none, or none that can be compared."""
    plain = _python(given)
    if not isinstance(plain, int | float) or isinstance(plain, bool) or isnan(plain):
        raise ValueError(f"{name}={plain!r}: give a number")
    return plain


def _recorded(name: str, given: object) -> None:
    """Raises ValueError for what `read` has not made."""
    if not isinstance(given, Recording):
        raise ValueError(f"{name}={_shown(given)}: give a recording, as read(...) makes it")


def _shown(given: object) -> str:
    """A value as it is named in a sentence: in one line, and of anything large its kind."""
    return repr(given) if isinstance(given, str | int | float | None) else f"a {type(given).__name__}"


def _quiet(what: str, share: float) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """Recorded traces: `traces`, the `column_map` by which they were read with its thresholds, and the map's `text`.

    `account` is a line for each file that adds up: cells used, refused, merged, not used; `said` what else a person
    should know of how it was understood.
    """

    traces: tuple[Trace, ...]
    column_map: ColumnMap
    text: str
    account: tuple[str, ...]
    said: tuple[str, ...]

    @property
    def temperature(self) -> str:
        """The signal that is modelled."""
        return self.column_map.temperature

    def frame(self) -> Frame:
        """The readings as a data frame, one row a time: `trace`, `machine`, `time`, then each signal in its unit.

        `time` is UTC where the clock counts since 1970, else seconds from its beginning; NaN where nothing was read.
        """
        parts = [
            pd.DataFrame(
                {"trace": trace.name, "machine": trace.machine, "time": _moments(trace.times), **trace.signals}
            )
            for trace in self.traces
        ]
        return pd.concat(parts, ignore_index=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedModel:
    """A learned `model`, and how it came about.

    `tables` are the learner's own by title: candidates, fits, held-out forecasts (degC, s). `drivers` has a row for
    each signal: its verdict, the shares (0 to 1) of the temperature's rises that it explains alone and beyond the other
    drivers, its gain in the end (degC per unit), the share of its own moves that the temperature foretells, and all of
    it as a sentence. `verdict` says where the model may be used ("": nobody has judged it), `warnings` what of the
    alphabet the traces cannot teach, and which signals nobody looked at.
    """

    model: Model
    tables: Mapping[str, Frame] = field(default_factory=dict)
    drivers: Frame = field(default_factory=pd.DataFrame)
    verdict: str = ""
    warnings: tuple[str, ...] = ()
    taught: TaughtModel | None = None

    def save(self, folder: str | Path) -> Path:
        """Write the model directory that every command takes; the path of its model.json.

        Raises ArtefactError where the folder holds something else or cannot be written.
        """
        if self.taught is not None:
            return self.taught.write(Path(folder))
        return write_model_directory(Path(folder), self.model)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What forecasts are worth: `by_horizon` and `by_machine`, a row for each horizon (s) and method, `differences`.

    CRPS, MAE, bias and half width are in the temperature's unit, coverage of the 90 % band is 0 to 1. `sentences` are
    the verdicts, `notes` say what could not be scored.
    """

    by_horizon: Frame
    by_machine: Frame
    differences: Frame
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    skill: ForecastSkill


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosedGap:
    """Where model and recording disagree: the `verdict` and its `sentence`, a row for each of the `effects` named.

    `places` are where heat is unexplained (degC/h, s, share 0 to 1). `model` is the one that has what was missing, None
    where nothing was named; `refused` says why that may not be deployed.
    """

    verdict: str
    sentence: str
    effects: Frame
    places: Frame
    model: LearnedModel | None
    refused: tuple[str, ...]
    diagnosis: Diagnosis


ModelLike = LearnedModel | Model | str | Path
"""A learned model, or the path of a model directory, a store or a model.json."""


def read(
    source: Frame | str | Path | Sequence[str | Path],
    column_map: ColumnMap | str | Path | None = None,
    *,
    temperature: str = "",
    current: str | Sequence[str] = (),
    running: str = "",
    on: str | Sequence[str] = (),
    good: str | Sequence[str] = (),
    time: str = "",
    dates: str = "",
    timezone: str = "",
    machine: str = "",
    session: str = "",
    stored: str = "",
    duplicates: str = "",
    clock_back: str = "",
    unit: str | Sequence[str] = (),
    guess: bool = False,
) -> Recording:
    """A recording from a data frame, a file, a folder or a pattern, as `decanter trace map` and `trace show` read it.

    A data frame has a row for each time and a column for each signal, or a row for each reading; its clock is a column
    of times or its index. The levels of an index are columns; times since a beginning are seconds. `column_map` is a
    map, its file, or a name in config/traces; without one it is drafted, and what the recording leaves open is answered
    by the other arguments, each as the option of that name of `trace map`: columns by their headers, `unit` as
    "COLUMN=UNIT". `guess` takes the most likely answer.

    Raises TraceError (a ValueError) with one sentence: nothing that can be used, or a question with its answers.
    """
    with _python_errors(""):
        answers = Answers(
            temperature=temperature,
            current=_several("current", current),
            running=running,
            time=time,
            dates=dates,
            on=_several("on", on),
            good=_several("good", good),
            timezone=timezone,
            machine=machine,
            session=session,
            stored=stored,
            duplicates=duplicates,
            clock_back=clock_back,
            unit=_several("unit", unit),
        )
    for each in fields(Answers):
        if not isinstance(own := getattr(answers, each.name), str | tuple):
            raise TraceError(f"{each.name}={_shown(own)}: give a text")
    if column_map is not None and answers != Answers():
        raise TraceError("a column map says it all; give either column_map or what is to be found out")
    if not isinstance(source, pd.DataFrame | str | Path) and not _is_paths(source):
        raise TraceError(f"source={_shown(source)}: give a data frame, a file, a folder, a pattern or a list of files")
    if column_map is not None and not isinstance(column_map, ColumnMap | str | Path):
        raise TraceError(f"column_map={_shown(column_map)}: give a map, its file, or a name in config/traces")
    if not isinstance(source, pd.DataFrame):
        return _read(source, column_map, answers, guess=guess, shown="")
    with TemporaryDirectory() as folder:
        path = Path(folder) / _FRAME
        spans = _write(source, path)
        if column_map is None:
            said = {text.rpartition("=")[0] for text in answers.unit}
            answers = replace(answers, unit=(*answers.unit, *(f"{name}=s" for name in spans if name not in said)))
        return _read(path, column_map, answers, guess=guess, shown=str(path))


def _is_paths(source: object) -> bool:
    return isinstance(source, list | tuple) and bool(source) and all(isinstance(each, str | Path) for each in source)


def _read(
    source: str | Path | Sequence[str | Path],
    column_map: ColumnMap | str | Path | None,
    answers: Answers,
    *,
    guess: bool,
    shown: str,
) -> Recording:
    """As `read`; `shown` is the path that stands for a data frame."""
    with _python_errors(shown):
        said: list[str] = []
        if column_map is None:
            if not isinstance(source, str | Path):
                raise TraceError("of several files somebody has to say how they are read; give column_map")
            text, told = _draft(Path(source), answers, guess=guess)
            column_map, said = parse_map(text, str(source)), [_plain(each, shown) for each in told]
        elif isinstance(column_map, ColumnMap):
            text = ""
        else:
            file = shipped_file("traces", str(column_map))
            column_map, text = load_map(file), file.read_text(encoding="utf-8")
        traces, report = load_traces(source, column_map)
    said += [
        _plain(each, shown) for each in (report.sentences() if report.refused or report.errors else report.warnings)
    ]
    return Recording(
        # Where the rows were on their way is gone when somebody asks where they come from.
        traces=tuple(replace(each, origin=_FROM if shown in each.origin else each.origin) for each in traces)
        if shown
        else tuple(traces),
        column_map=column_map.model_copy(update={"alphabet": report.alphabet}),
        text=text,
        account=tuple(file.account() for file in report.files if not file.error),
        said=tuple(dict.fromkeys(said)),
    )


def _draft(path: Path, answers: Answers, *, guess: bool) -> tuple[str, list[str]]:
    taken: list[str] = []
    while True:
        try:
            drafted = draft_map(path, answers, now=now())
        except Undecided as question:
            if not (guess and question.guess):
                raise
            taken.append(f"taken: {question.field} {question.guess!r}: {question.question}")
            answers = answers.with_answer(question.field, question.guess)
            continue
        return drafted.text, [*taken, *drafted.report]


def _write(frame: Frame, path: Path) -> list[str]:
    """The frame as the file that a recording is read from, and its columns of spans, which count in seconds there.

    Raises TraceError for one without rows or columns.
    """
    if frame.empty:
        raise TraceError(
            f"the data frame has {len(frame)} rows and {len(frame.columns)} columns; give one with readings"
        )
    levels = [frame.index.get_level_values(number) for number in range(frame.index.nlevels)]
    if frame.columns.nlevels > 1:
        frame = frame.set_axis([" ".join(str(part) for part in names if part != "") for names in frame.columns], axis=1)
    if len(levels) > 1 or levels[0].name is not None or (_is_clock(levels[0]) and not _numbers_rows(frame)):
        clocks = ["time" if _is_clock(level) else f"level {place}" for place, level in enumerate(levels)]
        names = [str(level.name or clock) for level, clock in zip(levels, clocks, strict=True)]
        if again := sorted({*names} & set(map(str, frame.columns))):
            raise TraceError(f"the data frame has {again[0]!r} as a column and in its index; drop one of them")
        frame = frame.rename_axis(names).reset_index()
    spans = frame.select_dtypes("timedelta").columns
    if len(spans):
        frame = frame.copy()
        frame[spans] = frame[spans].apply(lambda column: column.dt.total_seconds())
    if len(frame.columns) < 2:
        raise TraceError(f"the data frame has one column, {frame.columns[0]!r}; it needs a clock and a temperature")
    path.parent.mkdir()
    frame.to_csv(path, index=False)
    return [str(name) for name in spans]


def _numbers_rows(frame: Frame) -> bool:
    """Whether numbers in an index say no times, as a column does."""
    firsts = (pd.Index(frame.iloc[:, place].dropna().iloc[:1]) for place in range(frame.shape[1]))
    return pd.api.types.is_numeric_dtype(frame.index) and any(map(_is_clock, filter(len, firsts)))


def _is_clock(index: pd.Index) -> bool:
    """Whether an index is one of times; what merely numbers the rows that a filter has left is none."""
    if isinstance(index, _CLOCKS):
        return True
    if pd.api.types.is_numeric_dtype(index):
        return bool(dated_format(index.to_numpy(dtype=float), named=False))
    return bool(index.map(lambda each: isinstance(each, date) or (isinstance(each, str) and is_time(each)))[:1].any())


@contextmanager
def _python_errors(shown: str) -> Iterator[None]:
    """Have what is wrong told in the words of these functions, where the command would name its options."""
    try:
        yield
    except Undecided as question:
        name = question.field.replace("-", "_")
        choices = " or ".join(f"{name}={choice!r}" for choice in question.choices)
        likely = f" (most likely {question.guess!r}, which guess=True takes)" if question.guess else ""
        raise TraceError(_plain(f"{question.question}{likely}; give {choices}", shown)) from None
    except TraceError as error:
        raise TraceError(_plain(str(error), shown), error.report) from None
    except OSError as error:
        raise TraceError(sentence(error)) from None


def _plain(text: str, shown: str) -> str:
    text = _OPTION.sub(lambda match: match[1].replace("-", "_") + "=", text)
    return text.replace(shown, _FROM) if shown else text


@overload
def learn(
    recording: Recording,
    *,
    temperature: str | None = None,
    drivers: str | Sequence[str] = (),
    method: Method = "bins",
    settings: LshaSettings | None = None,
    name: str = "decanter",
    seed: int = 0,
    progress: Progress = _quiet,
) -> LearnedModel: ...


@overload
def learn(
    recording: Recording,
    *,
    temperature: list[str] | tuple[str, ...],
    drivers: str | Sequence[str] = (),
    method: Method = "bins",
    settings: LshaSettings | None = None,
    name: str = "decanter",
    seed: int = 0,
    progress: Progress = _quiet,
) -> dict[str, LearnedModel]: ...


def learn(
    recording: Recording,
    *,
    temperature: str | list[str] | tuple[str, ...] | None = None,
    drivers: str | Sequence[str] = (),
    method: Method = "bins",
    settings: LshaSettings | None = None,
    name: str = "decanter",
    seed: int = 0,
    progress: Progress = _quiet,
) -> LearnedModel | dict[str, LearnedModel]:
    """A model of a recording, as `decanter model learn` learns it; of several temperatures a model each, by signal.

    `temperature` is the map's where none is given. `drivers` are the signals that load the machine, in place of those
    of the map's alphabet: power, speed, a set point. `settings` are those of method `lsha`. The result depends on the
    readings and the `seed`, not on the order of the traces. Raises LearningError (a ValueError) where the recording
    cannot teach a model.
    """
    _recorded("recording", recording)
    _check_choice("method", method, get_args(Method))
    seed = _whole("seed", seed)
    if settings is not None and method != "lsha":
        raise ValueError('settings belong to method="lsha"; leave them out, or choose that method')
    lsha = (settings or LshaSettings()) if method == "lsha" else None
    warnings = tuple(
        use.sentence for use in channel_uses(recording.traces, recording.column_map.alphabet) if use.sentence
    )

    def one(signal: str) -> LearnedModel:
        taught = teach_model(
            recording.traces,
            recording.column_map,
            temperature=signal,
            drivers=_several("drivers", drivers),
            name=name,
            seed=seed,
            lsha=lsha,
            report=progress,
        )
        rows = [{**asdict(each), "sentence": each.sentence} for each in taught.drivers]
        tables = {title: pd.DataFrame(list(own)) for title, own in taught.shown.items()}
        return LearnedModel(
            model=taught.model,
            tables=tables,
            drivers=pd.DataFrame(rows),
            verdict=taught.verdict.sentence,
            warnings=(*warnings, *taught.not_looked_at),
            taught=taught,
        )

    if temperature is None or isinstance(temperature, str):
        return one(temperature or recording.temperature)
    return {signal: one(signal) for signal in _several("temperature", temperature)}


def forecast(
    model: ModelLike,
    recording: Recording,
    *,
    horizons: Sequence[float] = (60.0, 300.0, 900.0),
    period: float = 30.0,
    moments: int = MOST_MOMENTS,
    since: float = -inf,
    limit: float = inf,
    scan: float = 1.0,
    seed: int = 0,
) -> Frame:
    """What the running gateway would have forecast along a recording: a row for each moment and horizon.

    `horizons` (s, ascending) are asked for each `period` s, or less often, evenly, where a trace would have more than
    `moments`; none before `since` (s of the trace's clock). Columns: `trace`, `machine`, `time`, `horizon` (s), `due`;
    the quantiles `q05`, `q25`, `q50`, `q75`, `q95` of the reading then (the temperature's unit); `p_limit`, the
    probability that `limit` is reached by then. Nothing of what comes after a moment is known to its forecast. Raises
    ValueError for a trace without a signal that the model reads.
    """
    asked = _forecast_section(horizons, period, seed, moments=moments, scan=scan)
    since = _number("since", since)
    limit = _number("limit", limit)
    chosen = _runnable(model, recording)
    rows = []
    for trace in recording.traces:
        section = asked.model_copy(update={"period": spread_period(trace, asked.period, moments)})
        for made in forecast_trace([chosen], trace, section, scan_period=scan, since=since, limit=limit):
            for column, horizon in enumerate(made.horizons.tolist()):
                quantiles = dict(zip(made.levels, made.quantiles[:, column].tolist(), strict=True))
                rows.append({
                    "trace": trace.name,
                    "machine": trace.machine,
                    "time": made.time,
                    "horizon": horizon,
                    "due": made.time + horizon,
                    **{f"q{round(100 * level):02d}": quantiles[level] for level in FAN_LEVELS},
                    "p_limit": made.exceedance[column].probability,
                })  # fmt: skip
    if not rows:
        raise ValueError("there is no moment to forecast from; give a longer recording or an earlier since")
    frame = pd.DataFrame(rows)
    return frame.assign(time=_moments(frame["time"].to_numpy()), due=_moments(frame["due"].to_numpy()))


def _forecast_section(
    horizons: Sequence[float], period: float, seed: int, *, moments: int, scan: float
) -> ForecastSection:
    _whole("moments", moments, 1)
    if not 0 < _number("scan", scan) < inf:
        raise ValueError(f"scan={scan!r}: no scan is so long; give its seconds, above 0")
    wanted = {"horizons": horizons, "period": _python(period), "seed": _python(seed)}
    return validate_section(ForecastSection, wanted, "forecast")


def judge(
    model: ModelLike,
    recording: Recording,
    *,
    training: Recording | None = None,
    horizons: Sequence[float] = (60.0, 300.0, 900.0),
    period: float = 30.0,
    moments: int = MOST_MOMENTS,
    scan: float = 1.0,
    seed: int = 0,
    progress: Progress = _quiet,
) -> Judgement:
    """What a model's forecasts are worth along a held-out recording, as `decanter model judge skill` scores them.

    Beside persistence, and beside the statistical rivals fitted to `training` where that is given. Times as those of
    `forecast`. Raises ValueError where no forecast came due.
    """
    asked = _forecast_section(horizons, period, seed, moments=moments, scan=scan)
    if training is not None:
        _recorded("training", training)
    along = measure_skill(
        [_runnable(model, recording)],
        recording.traces,
        training=None if training is None else training.traces,
        forecasts=asked,
        scan=scan,
        moments=moments,
        report=progress,
    )
    found = along.found
    frames = {name: pd.DataFrame([dict(row) for row in rows]) for name, rows in found.tables.items()}
    return Judgement(
        by_horizon=frames["by horizon"],
        by_machine=frames["by machine"],
        differences=frames["differences"],
        sentences=tuple(found.sentences),
        notes=found.notes,
        skill=found,
    )


def diagnose(
    model: ModelLike,
    recording: Recording,
    *,
    out: str | Path | None = None,
    most: int = 3,
    seed: int = 0,
    progress: Progress = _quiet,
) -> DiagnosedGap:
    """Where a model and a recording disagree and what is missing, as `decanter diagnose` finds it.

    `most` effects are named at most. With `out` its folder gets report, pictures and the new model. Raises ValueError
    for a recording without what the model needs.
    """
    most = _whole("most", most)
    seed = _whole("seed", seed)
    chosen = _runnable(model, recording)
    with TemporaryDirectory() as folder:
        where = str(model) if isinstance(model, str | Path) else chosen.sha.name
        request = DiagnosisRequest(
            where=where,
            out=Path(folder) / "diagnosis" if out is None else Path(out),
            source="a recording",
            seed=seed,
            most=most,
            created=now(),
            report=out is not None,
        )
        result = run(request, chosen, recording.traces, signal_roles(recording.column_map, chosen), progress)
    diagnosis = result.diagnosis
    return DiagnosedGap(
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        effects=pd.DataFrame([asdict(effect) for effect in diagnosis.effects]),
        places=pd.DataFrame([asdict(place) for place in diagnosis.places]),
        model=None if result.model is None else LearnedModel(model=result.model),
        refused=result.verification or (),
        diagnosis=diagnosis,
    )


def simulate(
    model: ModelLike,
    recording: Recording,
    *,
    runs: int = 1000,
    policy: Policy = "resync",
    start: Start = "measured",
    seed: int = 0,
    progress: Progress = _quiet,
) -> Frame:
    """How far off a model comes out that runs along a recording's events and inputs, as `decanter model simulate` says.

    A row for each trace: errors in the temperature's unit, the 90 % band's coverage (0 to 1) over `runs` stochastic
    runs; a trace that the model cannot follow has the reason in `error`.
    """
    _check_choice("policy", policy, get_args(Policy))
    _check_choice("start", start, get_args(Start))
    runs = _whole("runs", runs, 2)
    seed = _whole("seed", seed)
    chosen = _runnable(model, recording)
    traces = [encode_trace(trace, chosen.alphabet) for trace in recording.traces]
    rows = simulate_traces(
        chosen, traces, runs=runs, policy=policy, start=start, seed=seed, picture=None, report=progress
    )
    return pd.DataFrame(rows)


def check(
    model: ModelLike,
    query: str,
    recording: Recording | None = None,
    *,
    start: str = "initial",
    runs: int | None = None,
    rare: bool = False,
    seed: int = 0,
    progress: Progress = _quiet,
) -> "Answer":
    """The answer to a query such as `Pr[<=600](<> Temp >= 80)`, as `decanter model check` gives it.

    Runs are driven by the events of the recording's only trace where there is one; `start` is that command's --from,
    `runs` asks for so many, `rare` for importance splitting. Times in s, temperatures in the model's unit. Raises
    ValueError for a query that cannot be read.
    """
    # An installation may be without queries, which nothing else here needs.
    from gateway.lab.checking.check import answer_query
    from sim.lab.checking.smc import QuerySettings

    if not isinstance(query, str):
        raise ValueError(f"query={_shown(query)}: give a text such as 'Pr[<=600](<> Temp >= 80)'")
    if not isinstance(start, str):
        raise ValueError(f"start={_shown(start)}: give a text such as 'initial'")
    if runs is not None:
        runs = _whole("runs", runs, 1)
    seed = _whole("seed", seed)
    if recording is not None:
        _recorded("recording", recording)
    traces = () if recording is None else recording.traces
    if len(traces) > 1:
        raise ValueError(f"the recording has {len(traces)} traces; a query takes one, whose events drive the runs")
    _modelled(model)
    if isinstance(model, str | Path):
        found = _find_model(model, recording)
    else:
        own = model.model if isinstance(model, LearnedModel) else model
        found = FoundModel(own.sha.name, own.sha, own)
    return answer_query(
        query,
        found,
        traces[0] if traces else None,
        settings=QuerySettings(runs=runs, rare=rare, seed=seed),
        origin=start,
        report=progress,
    )


def _find_model(where: str | Path, recording: Recording | None) -> FoundModel:
    if recording is None:
        return find_model(where)
    return find_model(where, alphabet=recording.column_map.alphabet, temperature=recording.temperature)


def _modelled(model: object) -> None:
    """Raises ValueError for what is neither a model nor the path of one."""
    if not isinstance(model, LearnedModel | Model | str | Path):
        raise ValueError(f"model={_shown(model)}: give a learned model, or the path of one")


def _runnable(model: ModelLike, recording: Recording) -> Model:
    _modelled(model)
    _recorded("recording", recording)
    if isinstance(model, LearnedModel):
        return model.model
    return model if isinstance(model, Model) else _find_model(model, recording).runnable()


def _moments(seconds: Array) -> pd.DatetimeIndex | Array:
    """Times in UTC where they count since 1970, else as they are."""
    return pd.to_datetime(seconds, unit="s", utc=True) if seconds.size and since_1970(float(seconds[0])) else seconds
