"""One readable JSON form that holds everything of a model, and the model's content hash.

Units are named in the file itself. Numbers are finite or the texts "inf" and "-inf"; NaN is refused. Lists keep the
model's order (locations, edges, channels: the order means something), objects are sorted by key. What the writer writes
the reader reads back as an equal model; what the reader would refuse the writer refuses already.
"""

import hashlib
import json
from collections.abc import Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Any

from sim.anomaly import AnomalyRecord
from sim.artefacts.effect_lines import effect_line_part, read_effect_line
from sim.artefacts.json_node import JsonNode, parse_json, written_number
from sim.effects import check_effect, check_sha, in_sensor_scale, of_machine
from sim.files import ArtefactError, read_text
from sim.sha import (
    DEFAULT_UNIT,
    SHA,
    Alphabet,
    Bins,
    Correction,
    Distribution,
    Edge,
    Effect,
    Entry,
    Flow,
    Input,
    Location,
    MachineCorrection,
    Model,
    PlainMember,
    Provenance,
    Stay,
    Switch,
    check_alphabet,
    check_distribution,
)

FORMAT = "decanter-sha-model"
VERSION = 1
EFFECTS_VERSION = 2
"""A model with effects: a program that does not know them must refuse it, never run it without."""
LINES_VERSION = 3
"""A model with an engineer's own effect, which brings its line along."""
UNITS: Mapping[str, str] = {
    "temperature": "degC",
    "time": "s",
    "k": "1/s",
    "noise": "degC/sqrt(s)",
    "max_rate": "degC/s",
    "gain": "degC per unit of the signal",
    "m": "degC (exponential, driven, logarithmic), degC/s (linear)",
}
TRANSIENT_UNITS: Mapping[str, str] = {
    **UNITS,
    "tau": "s",
    "m": "degC (exponential, driven, logarithmic, transient), degC/s (linear)",
}
"""Those of a model with a transient flow, whose own constant no other model has to explain."""
ENTRIES: dict[str, Entry] = {"parameter": "parameter", "resample": "resample", "none": "none"}
KEYS = (
    "format",
    "version",
    "units",
    "name",
    "temperature",
    "sensor_sigma",
    "sensor_memory",
    "limits",
    "initial_location",
    "locations",
    "edges",
    "effects",
    "alphabet",
    "initial_temperature",
    "semi_markov",
    "calibration",
    "correction",
    "machines",
    "borrowed",
    "plain",
    "anomalies",
    "roles",
    "provenance",
)


def _units(unit: str, units: Mapping[str, str] = UNITS) -> dict[str, str]:
    """The unit of every kind of number, for a model that follows a variable in `unit`."""
    return {key: text.replace(DEFAULT_UNIT, unit) for key, text in units.items()}


def _unit_table(sha: SHA) -> Mapping[str, str]:
    """The table for the flows that a model has: one without a transient keeps its text and its hash."""
    return TRANSIENT_UNITS if any(location.flow.kind == "transient" for location in sha.locations) else UNITS


def model_text(model: Model) -> str:
    """The model's JSON, ending in a newline. Raises ArtefactError for a model that could not be run when read back."""
    return json.dumps(model_document(model), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def model_hash(model: Model) -> str:
    """SHA-256 (64 hexadecimal digits) over the canonical JSON: keys sorted, no blanks, UTF-8."""
    # Not the file's own text: whoever lays it out anew, or sorts its keys, has the same model and the same hash.
    canonical = json.dumps(model_document(model), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def model_document(model: Model) -> dict[str, Any]:
    """The model as JSON's own types. Raises ArtefactError."""
    _check(model)
    sha = model.sha
    return {
        "format": FORMAT,
        "version": _version(sha),
        "units": _units(model.unit, _unit_table(sha)),
        "name": sha.name,
        "temperature": model.temperature,
        "sensor_sigma": written_number(model.sensor_sigma),
        # Left out where there is none, as are effects and correction: such a model keeps its text and its hash.
        **({"sensor_memory": written_number(model.sensor_memory)} if model.sensor_memory else {}),
        "limits": _numbers_part({"low": sha.low, "high": sha.high, "max_rate": sha.max_rate}),
        "initial_location": sha.initial,
        "locations": [_location_part(location) for location in sha.locations],
        "edges": [_edge_part(edge) for edge in sha.edges],
        **_effects_part(sha.effects),
        "alphabet": _alphabet_part(model.alphabet),
        "initial_temperature": _law_part(model.initial) if model.initial else None,
        "semi_markov": {name: _stay_part(stay) for name, stay in sorted(model.semi_markov.items())},
        "calibration": [
            {"horizon": written_number(horizon), "factor": written_number(factor)}
            for horizon, factor in sorted(model.calibration.items())
        ],
        **_correction_part(model.correction),
        **({"machines": _machines_part(model.machines)} if model.machines else {}),
        **({"borrowed": sorted(model.borrowed)} if model.borrowed else {}),
        **({"plain": [_plain_part(member) for member in model.plain]} if model.plain else {}),
        **({"anomalies": _anomalies_part(model.anomalies)} if model.anomalies is not None else {}),
        **({"roles": dict(model.roles)} if model.roles is not None else {}),
        "provenance": _provenance_part(model.provenance),
    }


def _version(sha: SHA) -> int:
    if any(effect.line is not None for effect in sha.effects):
        return LINES_VERSION
    return EFFECTS_VERSION if sha.effects else VERSION


def parse_model(text: str, file: str | Path = "model.json") -> Model:
    """The model in a JSON text. Raises ArtefactError with file and key path."""
    root = parse_json(text, file)
    # Format and version first, so that another version is not blamed for its keys.
    form, version = root.get("format").text(), root.get("version").integer()
    if form != FORMAT:
        raise root.get("format").error(f"this is {form!r}; a model has {FORMAT!r}")
    if version not in (VERSION, EFFECTS_VERSION, LINES_VERSION):
        known = f"{VERSION}, {EFFECTS_VERSION} (with effects) and {LINES_VERSION} (with own effects)"
        raise root.get("version").error(f"version {version} is unknown; this program reads the versions {known}")
    root.require_keys(KEYS)
    if version == VERSION and "effects" in root.value:
        raise root.get("effects").error(f"a model with effects has version {EFFECTS_VERSION}, here it is {version}")
    units = root.get("units").table(JsonNode.text)
    unit = units.get("temperature", DEFAULT_UNIT)
    stated = {**units, "temperature": unit}
    if stated not in (_units(unit), _units(unit, TRANSIENT_UNITS)):
        raise root.get("units").error(f"the units must be {_units(unit)}; convert the model's numbers and say so here")
    # The automaton first: what the other parts name (locations, signals) is checked against it.
    limits = root.get("limits").require_keys(("low", "high", "max_rate"))
    name, initial = root.get("name").text(), root.get("initial_location").text()
    locations = tuple(_read_location(node) for node in root.get("locations").each())
    edges = tuple(_read_edge(node) for node in root.get("edges").each())
    bounds = {key: limits.get(key).number() for key in ("max_rate", "low", "high")}
    effects = tuple(_read_effect(node) for node in root.get("effects").each()) if "effects" in root.value else ()
    if version != LINES_VERSION and any(effect.line is not None for effect in effects):
        raise root.get("version").error(f"a model with an own effect has version {LINES_VERSION}, here it is {version}")
    try:
        sha = SHA(name, locations, edges, initial, effects=effects, **bounds)
    except ValueError as error:
        raise root.error(str(error)) from None
    model = Model(
        sha=sha,
        alphabet=_read_alphabet(root.get("alphabet")),
        temperature=root.get("temperature").text(),
        sensor_sigma=root.get("sensor_sigma").number(),
        sensor_memory=root.get("sensor_memory").number() if "sensor_memory" in root.value else 0.0,
        initial=root.get("initial_temperature").optional(_read_law),
        semi_markov=root.get("semi_markov").table(_read_stay),
        calibration=_read_calibration(root.get("calibration")),
        provenance=_read_provenance(root.get("provenance")),
        correction=_read_correction(root),
        machines=root.get("machines").table(_read_machine) if "machines" in root.value else {},
        borrowed=_read_borrowed_names(root, sha),
        plain=tuple(_read_plain(node) for node in root.get("plain").each()) if "plain" in root.value else (),
        anomalies=_read_anomalies(root.get("anomalies")) if "anomalies" in root.value else None,
        roles=root.get("roles").table(JsonNode.text) if "roles" in root.value else None,
        unit=unit,
    )
    try:
        _check(model)
    except ArtefactError as error:
        raise root.error(str(error)) from None
    return model


def read_model_file(path: Path) -> Model:
    """The model in a JSON file. Raises ArtefactError with file and key path."""
    return parse_model(read_text(path), path)


def _check(model: Model) -> None:
    """Raises ArtefactError unless every flow, law and name of the model can be used."""
    known = model.sha.by_name
    try:
        check_sha(model.sha)
        check_alphabet(model.alphabet)
        in_sensor_scale(model)
        for name in model.machines:
            of_machine(model, name)
        if model.initial is not None:
            check_distribution(model.initial)
        for name, stay in model.semi_markov.items():
            check_distribution(stay.law)
            strange = [place for place in (name, *stay.to) if place not in known]
            if strange:
                raise ArtefactError(f"semi_markov.{name} names the location {strange[0]!r}, which is not defined")
    except ValueError as error:
        raise ArtefactError(str(error)) from None


# ------------------------------------------------------------------ the parts, each with its reader beside its writer


def _numbers_part(values: Mapping[str, float]) -> dict[str, float | str]:
    """A mapping of names to numbers, sorted by name."""
    return {name: written_number(value) for name, value in sorted(values.items())}


def _law_part(law: Distribution) -> dict[str, Any]:
    """A distribution."""
    return {"kind": law.kind, "params": _numbers_part(law.params)}


def _read_law(node: JsonNode) -> Distribution:
    """The distribution that `_law_part` wrote."""
    node.require_keys(("kind", "params"))
    return Distribution(node.get("kind").text(), node.get("params").table(JsonNode.number))


def _location_part(location: Location) -> dict[str, Any]:
    """A location with its flow."""
    flow = location.flow
    inputs = [
        {
            "signal": driving.signal,
            "gain": written_number(driving.gain),
            "reference": written_number(driving.reference),
        }
        for driving in flow.inputs
    ]
    return {
        "name": location.name,
        "flow": {"kind": flow.kind, "params": _numbers_part(flow.params), "inputs": inputs},
        "distribution": _law_part(location.distribution) if location.distribution else None,
        "entry": location.entry,
    }


def _read_location(node: JsonNode) -> Location:
    """The location that `_location_part` wrote."""
    node.require_keys(("name", "flow", "distribution", "entry"))
    entry = node.get("entry").text()
    if entry not in ENTRIES:
        raise node.get("entry").error(f"the entry mode {entry!r} is unknown; known are {', '.join(ENTRIES)}")
    flow = node.get("flow").require_keys(("kind", "params", "inputs"))
    inputs = []
    for part in flow.get("inputs").each():
        part.require_keys(("signal", "gain", "reference"))
        inputs.append(Input(part.get("signal").text(), part.get("gain").number(), part.get("reference").number()))
    return Location(
        node.get("name").text(),
        Flow(flow.get("kind").text(), flow.get("params").table(JsonNode.number), tuple(inputs)),
        node.get("distribution").optional(_read_law),
        ENTRIES[entry],
    )


def _edge_part(edge: Edge) -> dict[str, Any]:
    """An edge; `guard` only where there is one."""
    guard = {} if edge.guard is None else {"guard": edge.guard}
    return {"source": edge.source, "symbol": edge.symbol, "target": edge.target} | guard


def _read_edge(node: JsonNode) -> Edge:
    """The edge that `_edge_part` wrote."""
    node.require_keys(("source", "symbol", "target", "guard"))
    guard = node.get("guard").text() if "guard" in node.value else None
    return Edge(node.get("source").text(), node.get("symbol").text(), node.get("target").text(), guard)


def _effects_part(effects: tuple[Effect, ...]) -> dict[str, Any]:
    """The entry of the effects; none without them, so that a model without any keeps its text and its hash."""
    if not effects:
        return {}
    return {
        "effects": [
            {
                "kind": effect.kind,
                "params": _numbers_part(effect.params),
                "signals": dict(sorted(effect.signals.items())),
                "locations": list(effect.locations),
                "event": effect.event,
                **({"line": effect_line_part(effect.line)} if effect.line is not None else {}),
            }
            for effect in effects
        ]
    }


def _read_effect(node: JsonNode) -> Effect:
    node.require_keys(("kind", "params", "signals", "locations", "event", "line"))
    effect = Effect(
        node.get("kind").text(),
        node.get("params").table(JsonNode.number),
        node.get("signals").table(JsonNode.text),
        locations=tuple(item.text() for item in node.get("locations").each()),
        event=node.get("event").text(),
        line=read_effect_line(node.get("line")) if "line" in node.value else None,
    )
    try:
        check_effect(effect)
    except ValueError as error:
        raise node.error(str(error)) from None
    return effect


def _alphabet_part(alphabet: Alphabet) -> dict[str, Any]:
    """The alphabet with its channels in order."""
    channels: list[dict[str, Any]] = []
    for channel in alphabet.channels:
        if isinstance(channel, Switch):
            own: dict[str, Any] = {"rising": channel.rising, "falling": channel.falling}
        else:
            own = {
                "thresholds": [written_number(threshold) for threshold in channel.thresholds],
                "symbols": list(channel.symbols),
                "hysteresis": written_number(channel.hysteresis),
            }
        kind = "switch" if isinstance(channel, Switch) else "bins"
        channels.append({"kind": kind, "signal": channel.signal, **own, "on_change": channel.on_change})
    return {
        "channels": channels,
        "gap": written_number(alphabet.gap),
        "debounce": written_number(alphabet.debounce),
        "uppaal": [list(pair) for pair in alphabet.uppaal],
    }


def _read_alphabet(node: JsonNode) -> Alphabet:
    """The alphabet that `_alphabet_part` wrote."""
    node.require_keys(("channels", "gap", "debounce", "uppaal"))
    channels = tuple(_read_channel(channel) for channel in node.get("channels").each())
    uppaal = []
    for pair in node.get("uppaal").each():
        texts = [text.text() for text in pair.each()]
        if len(texts) != 2:
            raise pair.error(f"a pair [symbol, channel] is needed, but this has {len(texts)} elements")
        uppaal.append((texts[0], texts[1]))
    return Alphabet(channels, node.get("gap").number(), node.get("debounce").number(), tuple(uppaal))


def _read_channel(node: JsonNode) -> Switch | Bins:
    kind = node.get("kind").text()
    signal = node.get("signal").text()
    on_change = node.get("on_change").flag()
    if kind == "switch":
        node.require_keys(("kind", "signal", "rising", "falling", "on_change"))
        return Switch(signal, node.get("rising").text(), node.get("falling").text(), on_change)
    if kind != "bins":
        raise node.get("kind").error(f"the channel {kind!r} is unknown; known are switch, bins")
    node.require_keys(("kind", "signal", "thresholds", "symbols", "hysteresis", "on_change"))
    thresholds = tuple(item.number() for item in node.get("thresholds").each())
    symbols = tuple(item.text() for item in node.get("symbols").each())
    if len(symbols) != len(thresholds) + 1:
        raise node.error(f"{len(thresholds)} thresholds need {len(thresholds) + 1} symbols, here are {len(symbols)}")
    return Bins(signal, thresholds, symbols, node.get("hysteresis").number(), on_change)


def _stay_part(stay: Stay) -> dict[str, Any]:
    """A stay: sojourn law, next locations, input signals."""
    inputs = {
        signal: {"mean": written_number(mean), "sigma": written_number(sigma)}
        for signal, (mean, sigma) in sorted(stay.inputs.items())
    }
    return {"law": _law_part(stay.law), "to": _numbers_part(stay.to), "inputs": inputs}


def _read_stay(node: JsonNode) -> Stay:
    """The stay that `_stay_part` wrote."""
    node.require_keys(("law", "to", "inputs"))
    return Stay(
        _read_law(node.get("law")), node.get("to").table(JsonNode.number), node.get("inputs").table(_read_moments)
    )


def _read_moments(node: JsonNode) -> tuple[float, float]:
    node.require_keys(("mean", "sigma"))
    return node.get("mean").number(), node.get("sigma").number()


def _read_calibration(node: JsonNode) -> dict[float, float]:
    """The factors by horizon (s)."""
    pairs = [entry.require_keys(("horizon", "factor")) for entry in node.each()]
    factors = {entry.get("horizon").number(): entry.get("factor").number() for entry in pairs}
    if len(factors) < len(pairs):
        raise node.error("a horizon is given twice; keep one factor for each")
    return factors


def _anomalies_part(record: AnomalyRecord) -> dict[str, Any]:
    """What the anomaly score did on data held out."""
    return {
        "seconds": written_number(record.seconds),
        "units": record.units,
        "level": written_number(record.level),
        "peaks": [written_number(peak) for peak in record.peaks],
    }


def _read_anomalies(node: JsonNode) -> AnomalyRecord:
    """The record that `_anomalies_part` wrote."""
    node.require_keys(("seconds", "units", "level", "peaks"))
    try:
        return AnomalyRecord(
            seconds=node.get("seconds").number(),
            units=node.get("units").integer(),
            level=node.get("level").number(),
            peaks=tuple(peak.number() for peak in node.get("peaks").each()),
        )
    except ValueError as error:
        raise node.error(str(error)) from None


def _plain_part(member: PlainMember) -> dict[str, Any]:
    """A plain member; its heat only where there is one."""
    numbers = {"sensor": member.sensor, "walk": member.walk}
    if member.heat:
        numbers |= {"heat": member.heat, "memory": member.memory}
    if member.sensor_memory:
        numbers |= {"sensor_memory": member.sensor_memory}
    horizons = [
        {
            "horizon": written_number(horizon),
            "factor": written_number(member.calibration.get(horizon, 1.0)),
            "odds": written_number(member.odds.get(horizon, 1.0)),
        }
        for horizon in sorted({*member.calibration, *member.odds})
    ]
    return {"name": member.name, **_numbers_part(numbers), "horizons": horizons}


def _read_plain(node: JsonNode) -> PlainMember:
    """The plain member that `_plain_part` wrote."""
    node.require_keys(("name", "sensor", "walk", "heat", "memory", "sensor_memory", "horizons"))
    name, sensor, walk = node.get("name").text(), node.get("sensor").number(), node.get("walk").number()
    heat = node.get("heat").number() if "heat" in node.value else 0.0
    memory = node.get("memory").number() if "memory" in node.value else inf
    sensor_memory = node.get("sensor_memory").number() if "sensor_memory" in node.value else 0.0
    factors, odds = {}, {}
    for row in node.get("horizons").each():
        row.require_keys(("horizon", "factor", "odds"))
        horizon = row.get("horizon").number()
        factors[horizon], odds[horizon] = row.get("factor").number(), row.get("odds").number()
    try:
        return PlainMember(
            name, sensor, walk, heat=heat, memory=memory, sensor_memory=sensor_memory, calibration=factors, odds=odds
        )
    except ValueError as error:
        raise node.error(str(error)) from None


def _read_borrowed_names(root: JsonNode, sha: SHA) -> frozenset[str]:
    """The names of borrowed locations; none where the document says nothing."""
    if "borrowed" not in root.value:
        return frozenset()
    names, known = list(root.get("borrowed").each()), sha.by_name
    for node in names:
        if node.text() not in known:
            raise node.error(f"the automaton has no location {node.text()!r}")
    return frozenset(node.text() for node in names)


def _correction_part(correction: Correction) -> dict[str, Any]:
    """The entry of a correction; none for the identity, so that a model without one keeps its text and its hash."""
    if correction.identity:
        return {}
    return {"correction": _numbers_part({"gain": correction.gain, "offset": correction.offset})}


def _read_correction(root: JsonNode) -> Correction:
    """The correction of a model's document; the identity where it says nothing."""
    if "correction" not in root.value:
        return Correction()
    node = root.get("correction").require_keys(("gain", "offset"))
    try:
        return Correction(node.get("gain").number(), node.get("offset").number())
    except ValueError as error:
        raise node.error(str(error)) from None


MACHINE_NUMBERS = ("targets", "targets_error", "gain", "offset")


def _machines_part(machines: Mapping[str, MachineCorrection]) -> dict[str, Any]:
    """What is known of each machine of the type, by name."""
    return {
        name: {key: written_number(getattr(own, key)) for key in MACHINE_NUMBERS}
        for name, own in sorted(machines.items())
    }


def _read_machine(node: JsonNode) -> MachineCorrection:
    """What `_machines_part` wrote of one machine."""
    node.require_keys(MACHINE_NUMBERS)
    try:
        return MachineCorrection(**{key: node.get(key).number() for key in MACHINE_NUMBERS})
    except ValueError as error:
        raise node.error(str(error)) from None


def _provenance_part(provenance: Provenance) -> dict[str, Any]:
    """Where the model comes from. Raises ArtefactError for an infinite setting, which would come back as a text."""
    for name, value in sorted(provenance.settings.items()):
        if isinstance(value, float) and not isfinite(value):
            reason = "a setting is a finite number, a text or a flag"
            raise ArtefactError(f"provenance.settings.{name} is {value}; {reason}")
    return {
        "method": provenance.method,
        "data_hash": provenance.data_hash,
        "traces": list(provenance.traces),
        "synthetic": provenance.synthetic,
        "settings": dict(sorted(provenance.settings.items())),
        "scores": _numbers_part(provenance.scores),
        "parent": provenance.parent,
        # Left out where there is none, so that a model of a former release keeps its hash.
        **({"contents": list(provenance.contents)} if provenance.contents else {}),
    }


def _read_provenance(node: JsonNode) -> Provenance:
    """The provenance that `_provenance_part` wrote."""
    node.require_keys(("method", "data_hash", "traces", "synthetic", "settings", "scores", "parent", "contents"))
    return Provenance(
        method=node.get("method").text(),
        data_hash=node.get("data_hash").text(),
        traces=tuple(item.text() for item in node.get("traces").each()),
        synthetic=node.get("synthetic").flag(),
        settings=node.get("settings").table(_read_setting),
        scores=node.get("scores").table(JsonNode.number),
        parent=node.get("parent").text(),
        contents=tuple(item.text() for item in node.get("contents").each()) if "contents" in node.value else (),
    )


def _read_setting(node: JsonNode) -> str | float | int | bool:
    """A setting keeps its own type."""
    value = node.value
    if not isinstance(value, str | float | int):
        raise node.error(f"a text, a number, true or false is needed, but this is {value!r}")
    return value
