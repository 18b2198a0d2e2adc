"""Between a set of artefacts and an automaton that can be run.

What a distribution means depends on who wrote it:

- This project's sets and the thesis have a line per location in the report, which gives flow, law and entry mode. The
  thesis draws X on entry (`resample`), which is what a line without `entry` means.
- In the public learner's sets the number `D_i(mean)` is the mean of the flow's own parameter. For a first-order flow
  that is its rate (HRI: the learner estimates ln(v[i]/v[i-1]), so 1/s at one sample a second): our k is fixed to the
  mean, the target stays the equation's number, and the law is kept at the location without being drawn. With
  parameter="target" the number is taken as the target temperature m and drawn on entry, k being the equation's. For a
  linear or logarithmic flow both readings are the same: m is drawn. An equation with `m` says so itself.

The learner's node `__init__` stays a location of its own (constant, before the first event), since it may have several
edges; only an edge without an event, as this project writes it, makes its target the initial location.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Literal

from sim.effects import check_sha
from sim.files import ArtefactError
from sim.lab.formats.foreign.bundle import Artefacts
from sim.lab.formats.foreign.dot import INIT, Source, SourceLocation
from sim.lab.formats.foreign.flow_file import FlowFile
from sim.lab.formats.foreign.flow_kinds import recognise_flow, same_equation
from sim.lab.formats.foreign.histogram import evidence, fit_values
from sim.lab.formats.foreign.report import EFFECT_PREFIX, ReportedLocation
from sim.sha import (
    FIXED_PARAMETER,
    FLOWS,
    RELAXING_FLOWS,
    SHA,
    Distribution,
    Entry,
    Flow,
    Input,
    Location,
    nondeterminism,
)

Parameter = Literal["rate", "target"]
STILL_FLOW = Flow("constant", {"noise": 0.0})
PARAMETER_ALIASES: Mapping[str, str] = {
    "alpha": FIXED_PARAMETER,
    "a": FIXED_PARAMETER,
    "target": FIXED_PARAMETER,
    "rate": "k",
}
ENTRIES: Mapping[str, Entry] = {"parameter": "parameter", "resample": "resample", "none": "none"}


@dataclass(frozen=True, slots=True)
class Converted:
    """The automaton, and in sentences what the artefacts said that it does not: disagreements, several targets."""

    sha: SHA
    notes: tuple[str, ...] = ()


def structure(source: Source, name: str) -> SHA:
    """Locations and edges alone, every flow constant: for reachability, determinism and acceptance of words."""
    start = _start(source)
    locations = tuple(
        Location(location.name, STILL_FLOW, None, "none")
        for location in source.locations
        if location.name != INIT or start == INIT
    )
    return _sha(name, locations, source, start, {})


def to_sha(artefacts: Artefacts, parameter: Parameter = "rate") -> Converted:
    """The automaton that the artefacts describe; `parameter` says what a public distribution's number is.

    Raises ArtefactError, naming location and flow, where they describe none that can be run.
    """
    start = _start(artefacts.source)
    # The report's lines by the source's names; `Location 2` is `q_2` where there is no location `2`.
    names = {location.name for location in artefacts.source.locations}
    lines: dict[str, ReportedLocation] = {}
    for line in artefacts.report.locations:
        name = line.name if line.name in names else f"q_{line.name}"
        if name not in names:
            raise ArtefactError(
                f"{artefacts.name}: the report has a line for location {line.name!r}, which the source does not have"
            )
        lines[name] = line
    # A location with a line has its law there; only the public learner's need the distributions and the histogram.
    public = any(node.distribution and node.name not in lines for node in artefacts.source.locations)
    laws, notes = _laws(artefacts) if public else ({}, [])
    locations: list[Location] = []
    for node in artefacts.source.locations:
        if node.name == INIT and start != INIT:
            continue
        try:
            if node.name in lines:
                location = _from_line(node, lines[node.name], artefacts.flows)
            else:
                location, more = _from_equation(node, artefacts.flows, laws, parameter)
                notes += more
        except ArtefactError as error:
            raise ArtefactError(f"{artefacts.name}, location {node.name!r}: {error}") from None
        locations.append(location)
    sha = _sha(artefacts.name, tuple(locations), artefacts.source, start, artefacts.report.limits)
    lost = [
        f"the report names an effect that only the model's JSON holds, and that is left out here: {text}"
        for key, text in artefacts.report.performance
        if key.startswith(EFFECT_PREFIX)
    ]
    return Converted(sha, (*notes, *lost, *nondeterminism(sha)))


def _start(source: Source) -> str:
    """The initial location's name: `__init__`, or the target of its edge without an event."""
    starts = [edge for edge in source.edges if edge.source == INIT]
    if not starts:
        raise ArtefactError(f"the source has no edge from {INIT}, so no start is known; add {INIT} -> q_0")
    silent = [edge for edge in starts if not edge.symbol]
    if silent and len(starts) > 1:
        raise ArtefactError(f"{INIT} has an edge without an event beside others; keep that one or label all")
    return silent[0].target if silent else INIT


def _sha(name: str, locations: tuple[Location, ...], source: Source, start: str, limits: Mapping[str, float]) -> SHA:
    edges = tuple(edge for edge in source.edges if edge.source != INIT or start == INIT)
    known = {key: value for key, value in limits.items() if key in ("max_rate", "low", "high")}
    try:
        sha = SHA(name, locations, edges, start, effects=(), **known)
        check_sha(sha)
    except ValueError as error:
        raise ArtefactError(str(error)) from None
    return sha


def _laws(artefacts: Artefacts) -> tuple[dict[str, Distribution], list[str]]:
    """A normal law for each reported distribution: the report's mean; sigma from the histogram, else the variance."""
    reported = artefacts.report.distributions
    used = evidence(artefacts.histogram, reported) if artefacts.histogram else None
    sigmas = {law.name: 0.0 if law.variance is None else sqrt(law.variance) for law in reported}
    laws = {law.name: Distribution("normal", {"mu": law.mean, "sigma": sigmas[law.name]}) for law in reported}
    if used is not None:
        for name, values in used.values.items():
            if name in laws and values:
                laws[name] = Distribution("normal", {"mu": laws[name].params["mu"], "sigma": fit_values(values).sigma})
    return laws, list(used.disagreements) if used else []


def _from_line(node: SourceLocation, line: ReportedLocation, flows: FlowFile | None) -> Location:
    kind, written = line.calls.get("flow", ("constant", {}))
    if kind not in FLOWS:
        raise ArtefactError(f"the flow {kind!r} is unknown; known are {', '.join(FLOWS)}")
    constants, signals = {"noise": 0.0}, dict[str, dict[str, float]]()
    for name, value in written.items():
        signal, dot, part = name.rpartition(".")
        if dot and part in ("gain", "reference"):
            signals.setdefault(signal.strip("`"), {})[part] = value
        else:
            constants[PARAMETER_ALIASES.get(name, name)] = value
    inputs = (Input(name, parts.get("gain", 0.0), parts.get("reference", 0.0)) for name, parts in signals.items())
    flow = Flow(kind, constants, tuple(inputs))
    equation = flows.equations.get(node.flow) if flows and node.flow is not None else None
    if equation is not None and not same_equation(flow, equation):
        raise ArtefactError(
            f"the report's line says {flow.kind} with {dict(flow.params)}, the flow file's {node.flow} says "
            f"{equation.text!r}; correct one of them"
        )
    # A law of another kind is written out; mu and sigma alone, the thesis's form, are a normal one.
    mu, sigma = (line.values.get(name, 0.0) for name in ("mu", "sigma"))
    law = None
    if "law" in line.calls:
        law = Distribution(*line.calls["law"])
    elif "mu" in line.values and isinstance(mu, float) and isinstance(sigma, float):
        law = Distribution("normal", {"mu": mu, "sigma": sigma})
    entry = str(line.values.get("entry", "resample" if law else "none"))
    if entry not in ENTRIES:
        raise ArtefactError(f"the entry mode {entry!r} is unknown; known are {', '.join(ENTRIES)}")
    return Location(node.name, flow, law, ENTRIES[entry])


def _from_equation(
    node: SourceLocation, flows: FlowFile | None, laws: Mapping[str, Distribution], parameter: Parameter
) -> tuple[Location, list[str]]:
    if node.flow is None and node.distribution is None:
        return Location(node.name, STILL_FLOW, None, "none"), []
    flow = _flow_of_node(node, flows)
    if node.distribution is None:
        return Location(node.name, flow, None, "none"), []
    law = laws.get(node.distribution)
    if law is None:
        known = ", ".join(laws) or "none"
        raise ArtefactError(f"the distribution {node.distribution} is not in the report, which has {known}")
    if flow.kind == "constant":
        return Location(node.name, flow, law, "none"), []
    if flow.kind in RELAXING_FLOWS and FIXED_PARAMETER in flow.params and parameter == "rate":
        # k becomes the distribution's mean; the law stays at the location, undrawn, and what is lost is told.
        rate, own = law.params["mu"], flow.params["k"]
        if rate <= 0:
            raise ArtefactError(
                f"{node.distribution} has the mean {rate:g}, which cannot be an exponential flow's rate (positive, "
                '1/s); if it is the target temperature, say parameter="target"'
            )
        note = f"{node.name}: the rate is {rate:g} 1/s, the mean of {node.distribution}; the equation's is {own:g}"
        return Location(node.name, replace(flow, params={**flow.params, "k": rate}), law, "none"), [note]
    drawn = {name: value for name, value in flow.params.items() if name != FIXED_PARAMETER}
    return Location(node.name, replace(flow, params=drawn), law, "parameter"), []


def _flow_of_node(node: SourceLocation, flows: FlowFile | None) -> Flow:
    if node.flow is None:
        raise ArtefactError("its flow was never observed (ε), so nothing says how the temperature moves there")
    if flows is None:
        raise ArtefactError(f"it follows flow {node.flow}, but there is no flow_conditions.txt; add it")
    equation = flows.equations.get(node.flow)
    if equation is None:
        known = ", ".join(map(str, flows.equations)) or "none"
        raise ArtefactError(f"it follows flow {node.flow}, which flow_conditions.txt does not have (it has {known})")
    try:
        return recognise_flow(equation)
    except ArtefactError as error:
        raise ArtefactError(f"flow {node.flow}: {error}") from None
