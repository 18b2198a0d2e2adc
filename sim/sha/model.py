"""A model: the automaton with all that is needed to run it on a plant: alphabet, noise, sojourn laws, origin."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite

from sim.anomaly import AnomalyRecord
from sim.sha.automaton import SHA, Distribution, Edge, Effect, Flow, Location
from sim.sha.events import Alphabet, alphabet_symbols
from sim.units import DEFAULT_UNIT


@dataclass(frozen=True, slots=True)
class Stay:
    """How long the plant stays in a location and where it goes next, when the events to come are not known.

    `law` is the sojourn time's law in seconds, `to` the probability of each next location (they sum to 1; moves that
    take no time are folded into one). `inputs` gives (mean, sigma) of each input signal while in the location.
    """

    law: Distribution
    to: Mapping[str, float]
    inputs: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Correction:
    """What the sensor reads when the automaton is at T: T' = gain * T + offset (`offset` in degC).

    Raises ValueError unless the gain is positive and both are finite.
    """

    gain: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (isfinite(self.gain) and self.gain > 0 and isfinite(self.offset)):
            raise ValueError(f"a correction needs a positive gain and a finite offset, got {self.gain}, {self.offset}")

    @property
    def identity(self) -> bool:
        """True where the sensor reads what the automaton says."""
        return self.gain == 1.0 and self.offset == 0.0


@dataclass(frozen=True, slots=True)
class MachineCorrection:
    """What one machine has of its own in a model of its type.

    Its `targets` (degC) lie above the type's, known to `targets_error` (a standard deviation, degC); what its sensor
    reads is gain * T + offset. Raises ValueError for numbers that cannot be used.
    """

    targets: float = 0.0
    targets_error: float = 0.0
    gain: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        Correction(self.gain, self.offset)
        if not (isfinite(self.targets) and isfinite(self.targets_error) and self.targets_error >= 0):
            raise ValueError(
                f"a machine's targets need a finite shift and an error of at least 0, got {self.targets} and "
                f"{self.targets_error}"
            )


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a model comes from. `data_hash` is the SHA-256 over the training traces' content.

    `synthetic` says that no plant made those traces, `parent` is the version that this one was derived from. `contents`
    has the hash of each trace that had a part in it (`content_hash`), those of the models before it included: a trace
    is known again by it whatever its file is called.
    """

    method: str
    data_hash: str = ""
    traces: tuple[str, ...] = ()
    synthetic: bool = False
    settings: Mapping[str, str | float | int | bool] = field(default_factory=dict)
    scores: Mapping[str, float] = field(default_factory=dict)
    parent: str = ""
    contents: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PlainMember:
    """A forecaster that knows only the last readings: a random walk, perhaps under heat with a memory.

    `sensor` (degC), `walk` (degC/sqrt(s)) and `heat` (degC/s) are standard deviations; `memory` (s) is finite where
    there is heat; `sensor_memory` (s) and `calibration` are as a model's; `odds` (horizon in s -> its weight over the
    model's) say how the two compared on data held out. Raises ValueError for what cannot be run.
    """

    name: str
    sensor: float
    walk: float
    heat: float = 0.0
    memory: float = inf
    sensor_memory: float = 0.0
    calibration: Mapping[float, float] = field(default_factory=dict)
    odds: Mapping[float, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        noises = (self.sensor, self.walk, self.heat, self.sensor_memory)
        usable = all(isfinite(value) and value >= 0 for value in noises)
        if not usable or not self.memory > 0 or (self.heat > 0 and not isfinite(self.memory)):
            raise ValueError(f"the plain member {self.name!r} needs noises of at least 0 and, with heat, a memory")


@dataclass(frozen=True, slots=True)
class Model:
    """`sha` run on `temperature` (the signal's name), fed by events of `alphabet`.

    What is called a temperature is in `unit`: a model may follow another variable, such as a spindle's power in kW; all
    that is said here and elsewhere to be in degC is then in that unit.
    `sensor_sigma` is the sensor's standard deviation (degC), `sensor_memory` how long its error lasts (s; 0: each
    reading errs by itself), `initial` the law of a trace's first temperature as read,
    `semi_markov` the stay of each location by its name, `calibration` the factor by which the forecast's standard
    deviation at each horizon (s) must be multiplied to cover what it says (learned on held-out cycles). `correction`
    leads from the automaton's temperature to the sensor's; whoever runs a model speaks of the sensor's
    (`sim.effects.correction`), while `sha` alone is the automaton's own. `borrowed` are the locations that no data have
    shown: their parameters are another's, or what physics says. `plain` are the forecasters that may stand beside it.
    A model of a type of machine has what it knows of each of them in `machines`, by name (`sim.effects.of_machine`).
    `anomalies` is what its anomaly score did on data held out; None where nobody looked. `roles` are the parts that the
    plant's signals play to effects and cycles, by role; None where nobody said, {} where no signal plays one.
    """

    sha: SHA
    alphabet: Alphabet
    temperature: str
    sensor_sigma: float
    initial: Distribution | None = None
    semi_markov: Mapping[str, Stay] = field(default_factory=dict)
    calibration: Mapping[float, float] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=lambda: Provenance(method="by hand"))
    correction: Correction = Correction()
    borrowed: frozenset[str] = frozenset()
    plain: tuple[PlainMember, ...] = ()
    unit: str = DEFAULT_UNIT
    sensor_memory: float = 0.0
    machines: Mapping[str, MachineCorrection] = field(default_factory=dict)
    anomalies: AnomalyRecord | None = None
    roles: Mapping[str, str] | None = None


def plain_model(model: Model, member: PlainMember) -> Model:
    """A plain member as a model of one location, which every symbol of the alphabet leaves where it is.

    It predicts what `model` predicts, by the same alphabet, in the sensor's own scale. It has no range: where the
    readings have left the model's, it is the one who still follows them.
    """
    place = Location("any", Flow("constant", {"noise": member.walk}), entry="none")
    edges = tuple(Edge("any", symbol, "any") for symbol in alphabet_symbols(model.alphabet))
    effects = (Effect("heat-disturbance", {"sigma": member.heat, "memory": member.memory}),) if member.heat else ()
    sha = SHA(member.name, (place,), edges, "any", low=-inf, high=inf, effects=effects)
    return Model(
        sha,
        model.alphabet,
        model.temperature,
        member.sensor,
        sensor_memory=member.sensor_memory,
        calibration=member.calibration,
        unit=model.unit,
    )
