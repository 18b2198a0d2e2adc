"""The picture of a running gateway: one dataclass, for the status file, the control socket and all that shows it.

As JSON it is `dataclasses.asdict` by `sim.strict_json`: keys are fields, and what is not known or infinite is null.
Times are plant seconds UTC, ages and periods plant seconds; a key that ends in _s counts real seconds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from drivers.errors import OneLineError
from gateway.machine import Phase
from sim.strict_json import escape_text


class StatusError(OneLineError, ValueError):
    """A status that this program cannot read; the message says why and what to do."""


@dataclass(frozen=True, kw_only=True)
class TagStatus:
    """One tag: the newest reading, what it is worth at the status' time, and how old (`age`) it is by then."""

    value: bool | int | float | str | None
    quality: str
    time: float
    age: float
    reason: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class LinkStatus:
    """Whether good readings arrive; `last_good` is the time of the newest scan with one, `outages` the newest ones."""

    alive: bool
    connected: bool
    reason: str
    last_good: float | None
    outages: Sequence[Mapping[str, float | None]]
    outage_count: int


@dataclass(frozen=True, kw_only=True)
class ScanStatus:
    """The scans so far; `age` of the newest, None before the first. `late`: the next one is overdue."""

    count: int
    early: int
    missed: int
    period: float
    age: float | None
    late: bool


@dataclass(frozen=True, kw_only=True)
class VirtualStatus:
    """The model in place of a bad sensor: the fields of `gateway.machine.model.virtual_sensor.VirtualReading`."""

    since: float
    reason: str
    mean: float | None
    low: float | None
    high: float | None
    stopped: str = ""
    twin: str = ""


@dataclass(frozen=True, kw_only=True)
class StrangeStatus:
    """What is strange of a cycle: the fields of `sim.familiarity.StrangeThing`."""

    kind: Literal["", "above", "below", "together", "warmer", "colder"]
    features: Sequence[str]
    values: Sequence[float]
    bound: float | None


@dataclass(frozen=True, kw_only=True)
class FamiliarityStatus:
    """How like its training the present cycle is: the fields of `gateway.machine.model.FamiliarityRating`.

    `sentence` says in plant words what is strange, "" where nothing is.
    """

    zone: str
    limit: float
    time: float | None
    strangeness: float | None
    expected_error: float | None
    outside: bool
    thing: StrangeStatus
    sentence: str


@dataclass(frozen=True, kw_only=True)
class PredictionStatus:
    """What the model expected of the newest scan: the fields of `gateway.machine.model.ScanPrediction`."""

    time: float
    location: str
    location_index: int
    known: bool
    inputs_good: bool
    worst: int
    age: float | None
    measured: float | None
    mean: float | None
    low: float | None
    high: float | None
    free_run: float | None
    anomaly: float | None
    zone: str
    reset: bool
    free_sigma: float | None
    borrowed: bool
    virtual: VirtualStatus | None = None
    familiarity: FamiliarityStatus | None = None


@dataclass(frozen=True, kw_only=True)
class PastStatus:
    """A forecast's median `deviations` times `sigma` above the `mean` of what came after so many like `moments`.

    It is `flagged` beyond 3 of them. Mean and sigma are in the temperature's unit.
    """

    moments: int
    mean: float
    sigma: float
    deviations: float
    flagged: bool


@dataclass(frozen=True, kw_only=True)
class ForecastStatus:
    """The newest forecast: `quantiles` holds one fan a horizon (degC, by `levels`), `p_limit` one probability each.

    `usable`: it is fresh, and the state that it began from is still known. `block` are the fields of the write-back
    block that it fills, brought to the newest scan; of these, minutes without a value lie beyond the horizons.
    `coverage` is, by horizon, the share of recent 90 % bands that held what came; None before enough have matured.
    `postponed` counts those that waited since scans were skipped when they were due. `past` holds the median against
    what was measured after like moments, by horizon; None before enough of them are known.
    """

    time: float
    age: float
    usable: bool
    levels: Sequence[float]
    horizons: Sequence[float]
    quantiles: Sequence[Sequence[float | None]]
    p_limit: Sequence[float | None]
    factors: Sequence[float | None]
    block: Mapping[str, float | None]
    coverage: Sequence[float | None] = ()
    postponed: int = 0
    past: Sequence[PastStatus | None] = ()


@dataclass(frozen=True, kw_only=True)
class ModelStatus:
    """The model that runs: its store's version ("" for none), when its file was written, why a promotion is refused.

    `verdict` is whether it may be used, as it was judged where it was learned ("" where it was not), with its reasons.
    """

    name: str
    hash: str
    version: str
    written: float | None
    refused: str
    verdict: str = ""
    verdict_sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class AlarmStatus:
    """An alarm by ISA-18.2: its state and since when, what an operator shall do, and what comes of not doing it.

    `standing` is whether its condition stands, shown or not, `raised` when it was last announced. `until` is when a
    shelved one comes out; `by` and `reason` are of its last change by somebody. `possible` are the changes that persons
    can make now, by their names in the control socket. `of_plant` is one of the whole plant, which this machine
    looks after. `limit` is what its number must not exceed, `own_response` whether what to do is the plant's own words.
    `beyond` is whether the newest number is above the limit: an alarm goes on standing within its deadband and delay,
    and where its number is not known (None).
    """

    name: str
    tag: str
    priority: int
    state: str
    active: bool
    since: float
    acknowledged_by: str
    response: str
    consequence: str = ""
    kind: str = ""
    standing: bool = False
    raised: float | None = None
    first_up: bool = False
    until: float | None = None
    by: str = ""
    reason: str = ""
    possible: Sequence[str] = ()
    of_plant: bool = False
    limit: float | None = None
    own_response: bool = True
    beyond: bool | None = None


@dataclass(frozen=True, kw_only=True)
class HistorianStatus:
    """Where the records lie, how many rows were lost, and why they cannot be relied on ("": they can)."""

    path: str
    dropped: int
    refused: int
    failure: str
    complaint: str


@dataclass(frozen=True, kw_only=True)
class TemperatureStatus:
    """What is said of one more temperature that a machine follows; the fields are those of GatewayStatus."""

    temperature: str
    unit: str
    limit: float
    prediction: PredictionStatus | None
    forecast: ForecastStatus | None
    model: ModelStatus | None
    guards: Mapping[str, Any] | None
    writeback: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class GatewayStatus:
    """Everything worth showing of one `machine` at `time`; `further` are its temperatures beside the first one.

    `place` is where its device is, `temperature` the tag that is predicted, `limit` (in `unit`) its alarm limit,
    `watched` the limits of the temperatures that have one and are not predicted, by their tags,
    `speed` plant seconds per real second. `alarms` is every alarm's state by name, `alarm_summary` those that are not
    normal. `prediction`, `forecast`, `model` and `guards` are None without a model, or before the first.
    `writeback` has `mode`, and where blocks are computed `armed_by`, `armed_until`, the writer's counters,
    `last_verdict` with `last_reason`, and the `block`: its address, how many words, and the numbers of the newest one.
    `parts` are the supervised threads and tasks.
    """

    machine: str
    time: float
    phase: Phase
    speed: float
    place: str
    temperature: str
    unit: str
    limit: float
    link: LinkStatus
    links: Sequence[Mapping[str, Any]]
    scan: ScanStatus
    values: Mapping[str, TagStatus]
    prediction: PredictionStatus | None
    forecast: ForecastStatus | None
    model: ModelStatus | None
    guards: Mapping[str, Any] | None
    events: int
    recent_events: Sequence[tuple[float, str, str]]
    alarms: Mapping[str, str]
    alarm_summary: Sequence[AlarmStatus]
    writeback: Mapping[str, Any]
    further: Sequence[TemperatureStatus]
    historian: HistorianStatus
    parts: Mapping[str, Mapping[str, Any]]
    clock: Mapping[str, Any]
    driver: Mapping[str, Any]
    complaints: Sequence[str]
    failures: int
    last_failure: str
    watched: Mapping[str, float] = field(default_factory=dict)


@cache
def _reader() -> TypeAdapter[GatewayStatus]:
    return TypeAdapter(GatewayStatus)  # at its first use: it takes longer than most commands that read no status


def read_status(plain: object) -> GatewayStatus:
    """The status as a gateway wrote it (JSON's values); texts come out printable, keys that are not known are left out.

    Raises StatusError for what is no status of this program's version.
    """
    try:
        return _reader().validate_python(escape_text(plain))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"])) or "the status"
        raise StatusError(
            f"the gateway's status cannot be read ({key}: {first['msg'].lower()}): it runs another version of this "
            "program; stop it and start it anew"
        ) from None
