"""`decanter model show`: a model as text or JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from math import nan
from typing import TYPE_CHECKING, Any

from gateway.console import CommandResult, Line, Part, Rows, conclude
from gateway.entry import sentences
from sim.anomaly import MAX_LEVEL
from sim.artefacts import NO_VERDICT_TEXT, ModelVerdict, model_hash
from sim.effects import effect_summary
from sim.lab.formats import find_model
from sim.sha import SHA, Model, Stay, display_unit, distributions

if TYPE_CHECKING:
    from sim.lab.formats import FoundModel
    from sim.lab.learning import MachineSpread


def show(name: str, as_json: bool) -> None:
    """The work of `model show`."""
    with sentences():
        found_model = find_model(name)
        if found_model.model is None or found_model.artefacts is not None:
            structure = found_model.structure
            data = {
                "name": found_model.name,
                "initial": structure.initial,
                "locations": _location_rows(structure, {}),
                "edges": [
                    {"source": edge.source, "symbol": edge.symbol, "target": edge.target, "guard": edge.guard}
                    for edge in structure.edges
                ],
                "runnable": found_model.model is not None,
                "refusal": found_model.refusal,
                "notes": list(found_model.notes),
            }
            conclude(CommandResult(data), lambda _: _show_artefacts(found_model), as_json=as_json)
            return
        shown = found_model.model
        verdict = found_model.verdict

        def show_both() -> Iterator[Part]:
            yield from show_model(shown)
            yield from show_verdict(verdict)

        said = {"verdict": None if verdict is None else verdict.as_command_json()}
        conclude(CommandResult(summary(shown) | said), lambda _: show_both(), as_json=as_json)


def _show_artefacts(found_model: FoundModel) -> Iterator[Part]:
    sha = found_model.structure
    if found_model.model is None:
        yield Rows(
            f"{found_model.name}: {len(sha.locations)} locations", ["location"], [[each.name] for each in sha.locations]
        )
    else:
        rows = _location_rows(sha, {})
        yield Rows(f"{found_model.name}: {len(rows)} locations", list(rows[0]), [list(row.values()) for row in rows])
    yield Rows(f"{len(sha.edges)} edges", ["from", "symbol", "to"], [[e.source, e.symbol, e.target] for e in sha.edges])
    yield from found_model.notes
    if found_model.refusal:
        yield Line(f"it cannot be run: {found_model.refusal}", "yellow")


def summary(shown: Model) -> dict[str, Any]:
    """The model as plain values for JSON."""
    return {
        "name": shown.sha.name,
        "hash": model_hash(shown),
        "temperature": shown.temperature,
        "sensor_sigma": shown.sensor_sigma,
        "sensor_memory": shown.sensor_memory,
        "correction": {"gain": shown.correction.gain, "offset": shown.correction.offset},
        "machines": {name: asdict(own) for name, own in sorted(shown.machines.items())},
        "locations": _location_rows(shown.sha, shown.semi_markov),
        "edges": len(shown.sha.edges),
        "effects": [
            {
                "kind": effect.kind,
                "params": dict(effect.params),
                "signals": dict(effect.signals),
                "locations": list(effect.locations),
                "event": effect.event,
                **({"heat": effect.line.heat} if effect.line is not None else {}),
            }
            for effect in shown.sha.effects
        ],
        "borrowed": sorted(shown.borrowed),
        "plain": [asdict(member) for member in shown.plain],
        "anomalies": None if shown.anomalies is None else asdict(shown.anomalies),
        "provenance": {
            "method": shown.provenance.method,
            "data_hash": shown.provenance.data_hash,
            "traces": list(shown.provenance.traces),
            "synthetic": shown.provenance.synthetic,
            "settings": dict(shown.provenance.settings),
            "scores": dict(shown.provenance.scores),
        },
    }


def _location_rows(sha: SHA, stays: Mapping[str, Stay]) -> list[dict[str, Any]]:
    rows = []
    for location in sha.locations:
        law: Mapping[str, float] = location.distribution.params if location.distribution else {}
        stay = stays.get(location.name)
        row: dict[str, Any] = {"location": location.name, "flow": location.flow.kind}
        row |= {name: law.get(name, nan) for name in ("mu", "sigma")}
        row |= {name: location.flow.params.get(name, nan) for name in ("k", "noise")}
        row["gain"] = location.flow.inputs[0].gain if location.flow.inputs else nan
        row["stay_s"] = distributions.mean(stay.law) if stay else nan
        row["next"] = max(stay.to, key=lambda name: stay.to[name]) if stay and stay.to else ""
        rows.append(row)
    return rows


def show_model(shown: Model) -> Iterator[Part]:
    """Print the model's locations, its effects and where it comes from."""
    rows = _location_rows(shown.sha, shown.semi_markov)
    columns = list(rows[0])
    yield Rows(
        f"{shown.sha.name}: {len(rows)} locations, {len(shown.sha.edges)} edges",
        columns,
        [list(row.values()) for row in rows],
    )
    unit = display_unit(shown.unit)
    for effect in shown.sha.effects:
        match effect.kind:
            case "heat-disturbance":
                sigma, memory = effect.params["sigma"], effect.params["memory"]
                yield f"disturbance: heat that comes and goes by {sigma:.3g} {unit}/s, with a memory of {memory:.4g} s"
            case "machine-offset":
                yield f"machines: the next one's targets lie off the model's by {effect.params['sigma']:.3g} {unit}"
            case _:
                yield f"effect {effect_summary(effect)}"
    if shown.machines:
        rows_of_machines = [
            [name, f"{own.targets:+.3g} ± {own.targets_error:.2g}", f"{own.gain:.4g}", f"{own.offset:+.3g}"]
            for name, own in sorted(shown.machines.items())
        ]
        yield f"a model of a type of machine; of its targets ({unit}) and sensor (T' = k T + b) each has its own:"
        yield Rows("machines", ("machine", "targets", "k", "b"), rows_of_machines)
    elif "machine" in shown.provenance.settings:
        yield f"of the machine {shown.provenance.settings['machine']}, of the type that it was learned with"
    if shown.borrowed:
        yield f"borrowed, as no data have shown them: {', '.join(sorted(shown.borrowed))}"
    for member in shown.plain:
        odds = ", ".join(f"{horizon:g} s {value:.3g}" for horizon, value in sorted(member.odds.items()))
        yield f"plain member {member.name}: {f'odds against the model {odds}' if odds else 'no odds were learned'}"
    origin = shown.provenance
    lasts = f" (errors last {shown.sensor_memory:g} s)" if shown.sensor_memory else ""
    sensor = f"{shown.sensor_sigma:.3g} {unit}{lasts}"
    yield f"temperature {shown.temperature}, sensor sigma {sensor}, method {origin.method}"
    if shown.calibration:
        yield "calibration " + ", ".join(f"{h:g} s x {f:.2f}" for h, f in sorted(shown.calibration.items()))
    if (seen := shown.anomalies) is not None:
        spans = f"{seen.seconds / 3600.0:.3g} h of {seen.units} recordings or machines that were held out"
        often = "once a week at most" if seen.level < MAX_LEVEL else "more often than once a week"
        yield f"anomaly: a score of {seen.level:g} is passed {often}, by {spans}"
    if not shown.correction.identity:
        yield f"correction T' = {shown.correction.gain:.4g} T {shown.correction.offset:+.3g} {unit}"
    synthetic = ", SYNTHETIC: not learned from a plant" if origin.synthetic else ""
    yield f"{len(origin.traces)} traces, content {origin.data_hash[:12]}{synthetic}"


def show_verdict(verdict: ModelVerdict | None) -> Iterator[Part]:
    """The verdict that lies beside a model, in one line, or that there is none."""
    yield NO_VERDICT_TEXT if verdict is None else Line(verdict.sentence, _COLOURS[verdict.word])


_COLOURS = {"fit": "green", "limited": "yellow", "not known": "yellow", "unfit": "red"}


def spread_sentence(spread: MachineSpread, unit: str) -> str:
    """What the training says of the spread between machines, in words; `unit` as people read it."""
    count = len(spread.offsets)
    if count < 2 and spread.told_apart < 2:
        return "machines: fewer than two are told apart in the training, so nothing is known of how they differ"
    if count < 2:
        why = (
            "of fewer than two of them the runs tell where its targets lie"
            if spread.has_targets
            else "no flow of the model has a target by which they could (linear, logarithmic, constant)"
        )
        return f"machines: {spread.told_apart} are told apart, but nothing is known of how they differ: {why}"
    if spread.sigma == 0:
        return f"machines: the {count} of the training differ by no more than their errors tell"
    few = {2: "two machines only: wide bands; ", 3: "three machines only: wide bands; "}.get(count, "")
    offsets = ", ".join(f"{name} {offset:+.3g}" for name, offset in spread.offsets.items())
    return (
        f"machines: {few}targets off the model's by {offsets} {unit}, {spread.between:.3g} {unit} between machines, "
        f"{spread.sigma:.3g} {unit} for the next one"
    )
