"""The parts of a model in JSON, each with its reader beside its writer."""

from collections.abc import Mapping
from math import isfinite
from typing import Any

from sim.artefacts.files import ArtefactError
from sim.artefacts.json_reading import Node, written_number
from sim.effects.check import check_effect
from sim.sha.automaton import Distribution, Edge, Effect, Entry, Flow, Input, Location
from sim.sha.events import Alphabet, Bins, Switch
from sim.sha.model import Correction, Provenance, Stay

ENTRIES: dict[str, Entry] = {"parameter": "parameter", "resample": "resample", "none": "none"}


def numbers_part(values: Mapping[str, float]) -> dict[str, float | str]:
    """A mapping of names to numbers, sorted by name."""
    return {name: written_number(value) for name, value in sorted(values.items())}


def law_part(law: Distribution) -> dict[str, Any]:
    """A distribution."""
    return {"kind": law.kind, "params": numbers_part(law.params)}


def law_of(node: Node) -> Distribution:
    """The distribution that `law_part` wrote."""
    node.only(("kind", "params"))
    return Distribution(node.get("kind").text(), node.get("params").table(Node.number))


def location_part(location: Location) -> dict[str, Any]:
    """A location with its flow."""
    flow = location.flow
    inputs = [
        {"signal": one.signal, "gain": written_number(one.gain), "reference": written_number(one.reference)}
        for one in flow.inputs
    ]
    return {
        "name": location.name,
        "flow": {"kind": flow.kind, "params": numbers_part(flow.params), "inputs": inputs},
        "distribution": law_part(location.distribution) if location.distribution else None,
        "entry": location.entry,
    }


def location_of(node: Node) -> Location:
    """The location that `location_part` wrote."""
    node.only(("name", "flow", "distribution", "entry"))
    entry = node.get("entry").text()
    if entry not in ENTRIES:
        raise node.get("entry").error(f"the entry mode {entry!r} is unknown; known are {', '.join(ENTRIES)}")
    flow = node.get("flow").only(("kind", "params", "inputs"))
    inputs = tuple(_input_of(one) for one in flow.get("inputs").each())
    return Location(
        node.get("name").text(),
        Flow(flow.get("kind").text(), flow.get("params").table(Node.number), inputs),
        node.get("distribution").optional(law_of),
        ENTRIES[entry],
    )


def _input_of(node: Node) -> Input:
    node.only(("signal", "gain", "reference"))
    return Input(node.get("signal").text(), node.get("gain").number(), node.get("reference").number())


def edge_part(edge: Edge) -> dict[str, Any]:
    """An edge; `guard` only where there is one."""
    guard = {} if edge.guard is None else {"guard": edge.guard}
    return {"source": edge.source, "symbol": edge.symbol, "target": edge.target} | guard


def edge_of(node: Node) -> Edge:
    """The edge that `edge_part` wrote."""
    node.only(("source", "symbol", "target", "guard"))
    guard = node.get("guard").text() if "guard" in node.value else None
    return Edge(node.get("source").text(), node.get("symbol").text(), node.get("target").text(), guard)


def effects_part(effects: tuple[Effect, ...]) -> dict[str, Any]:
    """The entry of the effects; none without them, so that a model without any keeps its text and its hash."""
    if not effects:
        return {}
    return {
        "effects": [
            {
                "kind": effect.kind,
                "params": numbers_part(effect.params),
                "signals": dict(sorted(effect.signals.items())),
                "locations": list(effect.locations),
                "event": effect.event,
            }
            for effect in effects
        ]
    }


def effects_of(root: Node) -> tuple[Effect, ...]:
    """The effects of a model's document; none where it says nothing."""
    if "effects" not in root.value:
        return ()
    return tuple(_effect_of(node) for node in root.get("effects").each())


def _effect_of(node: Node) -> Effect:
    node.only(("kind", "params", "signals", "locations", "event"))
    effect = Effect(
        node.get("kind").text(),
        node.get("params").table(Node.number),
        node.get("signals").table(Node.text),
        tuple(one.text() for one in node.get("locations").each()),
        node.get("event").text(),
    )
    try:
        check_effect(effect)
    except ValueError as error:
        raise node.error(str(error)) from None
    return effect


def alphabet_part(alphabet: Alphabet) -> dict[str, Any]:
    """The alphabet with its channels in order."""
    return {
        "channels": [_channel_part(channel) for channel in alphabet.channels],
        "gap": written_number(alphabet.gap),
        "debounce": written_number(alphabet.debounce),
        "uppaal": [list(pair) for pair in alphabet.uppaal],
    }


def _channel_part(channel: Switch | Bins) -> dict[str, Any]:
    if isinstance(channel, Switch):
        names = {"kind": "switch", "signal": channel.signal, "rising": channel.rising, "falling": channel.falling}
        return names | {"on_change": channel.on_change}
    return {
        "kind": "bins",
        "signal": channel.signal,
        "thresholds": [written_number(threshold) for threshold in channel.thresholds],
        "symbols": list(channel.symbols),
        "hysteresis": written_number(channel.hysteresis),
        "on_change": channel.on_change,
    }


def alphabet_of(node: Node) -> Alphabet:
    """The alphabet that `alphabet_part` wrote."""
    node.only(("channels", "gap", "debounce", "uppaal"))
    channels = tuple(_channel_of(channel) for channel in node.get("channels").each())
    uppaal = tuple(_pair_of(pair) for pair in node.get("uppaal").each())
    return Alphabet(channels, node.get("gap").number(), node.get("debounce").number(), uppaal)


def _pair_of(node: Node) -> tuple[str, str]:
    texts = [text.text() for text in node.each()]
    if len(texts) != 2:
        raise node.error(f"a pair [symbol, channel] is needed, but this has {len(texts)} elements")
    return texts[0], texts[1]


def _channel_of(node: Node) -> Switch | Bins:
    kind = node.get("kind").text()
    signal = node.get("signal").text()
    on_change = node.get("on_change").flag()
    if kind == "switch":
        node.only(("kind", "signal", "rising", "falling", "on_change"))
        return Switch(signal, node.get("rising").text(), node.get("falling").text(), on_change)
    if kind != "bins":
        raise node.get("kind").error(f"the channel {kind!r} is unknown; known are switch, bins")
    node.only(("kind", "signal", "thresholds", "symbols", "hysteresis", "on_change"))
    thresholds = tuple(one.number() for one in node.get("thresholds").each())
    symbols = tuple(one.text() for one in node.get("symbols").each())
    if len(symbols) != len(thresholds) + 1:
        raise node.error(f"{len(thresholds)} thresholds need {len(thresholds) + 1} symbols, here are {len(symbols)}")
    return Bins(signal, thresholds, symbols, node.get("hysteresis").number(), on_change)


def stay_part(stay: Stay) -> dict[str, Any]:
    """A stay: sojourn law, next locations, input signals."""
    inputs = {
        signal: {"mean": written_number(mean), "sigma": written_number(sigma)}
        for signal, (mean, sigma) in sorted(stay.inputs.items())
    }
    return {"law": law_part(stay.law), "to": numbers_part(stay.to), "inputs": inputs}


def stay_of(node: Node) -> Stay:
    """The stay that `stay_part` wrote."""
    node.only(("law", "to", "inputs"))
    return Stay(law_of(node.get("law")), node.get("to").table(Node.number), node.get("inputs").table(_moments_of))


def _moments_of(node: Node) -> tuple[float, float]:
    node.only(("mean", "sigma"))
    return node.get("mean").number(), node.get("sigma").number()


def correction_part(correction: Correction) -> dict[str, Any]:
    """The entry of a correction; none for the identity, so that a model without one keeps its text and its hash."""
    if correction.identity:
        return {}
    return {"correction": numbers_part({"gain": correction.gain, "offset": correction.offset})}


def correction_of(root: Node) -> Correction:
    """The correction of a model's document; the identity where it says nothing."""
    if "correction" not in root.value:
        return Correction()
    node = root.get("correction").only(("gain", "offset"))
    try:
        return Correction(node.get("gain").number(), node.get("offset").number())
    except ValueError as error:
        raise node.error(str(error)) from None


def provenance_part(provenance: Provenance) -> dict[str, Any]:
    """Where the model comes from."""
    return {
        "method": provenance.method,
        "data_hash": provenance.data_hash,
        "traces": list(provenance.traces),
        "synthetic": provenance.synthetic,
        "settings": {name: _setting(name, value) for name, value in sorted(provenance.settings.items())},
        "scores": numbers_part(provenance.scores),
        "parent": provenance.parent,
    }


def _setting(name: str, value: str | float | int | bool) -> str | float | int | bool:
    """A setting as it is. Raises ArtefactError for an infinite one, which would come back as a text."""
    if isinstance(value, float) and not isfinite(value):
        raise ArtefactError(f"provenance.settings.{name} is {value}; a setting is a finite number, a text or a flag")
    return value


def provenance_of(node: Node) -> Provenance:
    """The provenance that `provenance_part` wrote."""
    node.only(("method", "data_hash", "traces", "synthetic", "settings", "scores", "parent"))
    return Provenance(
        method=node.get("method").text(),
        data_hash=node.get("data_hash").text(),
        traces=tuple(one.text() for one in node.get("traces").each()),
        synthetic=node.get("synthetic").flag(),
        settings=node.get("settings").table(_setting_of),
        scores=node.get("scores").table(Node.number),
        parent=node.get("parent").text(),
    )


def _setting_of(node: Node) -> str | float | int | bool:
    """A setting keeps its own type."""
    value = node.value
    if not isinstance(value, str | float | int):
        raise node.error(f"a text, a number, true or false is needed, but this is {value!r}")
    return value
