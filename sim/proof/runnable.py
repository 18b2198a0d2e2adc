"""Whether a model can be run at all: flows, laws, entries, guards, and every number beside the automaton."""

from collections.abc import Iterator
from math import isfinite

from sim.effects import check_sha, in_sensor_scale
from sim.proof.structure import guarded_edges
from sim.sha import (
    SHA,
    Location,
    Model,
    alphabet_symbols,
    check_alphabet,
    check_distribution,
    compile_chain,
    mean,
    variance,
)


def faults(model: Model) -> tuple[str, ...]:
    """What keeps a model from being run, one sentence each; empty for one that can be run along a word or a trace."""
    return guard_notes(model.sha) or tuple(_strange_numbers(model))


def guard_notes(sha: SHA) -> tuple[str, ...]:
    """One sentence for each edge with a guard; empty without any."""
    why = "guards speak of variables that no trace carries, so an automaton with guards is refused for running"
    return tuple(f"{guard}; {why}" for guard in guarded_edges(sha))


def silence_reason(model: Model) -> str:
    """Why no plant could ever move the model ("" where one can): its events come from the alphabet alone."""
    try:
        check_alphabet(model.alphabet)
    except ValueError as error:
        return str(error)
    symbols = set(alphabet_symbols(model.alphabet))
    edges = {edge.symbol for edge in model.sha.edges}
    if edges and not edges & symbols:
        few = ", ".join(sorted(edges)[:3])
        return f"no edge has a symbol of the alphabet, {', '.join(sorted(symbols)[:6])}; those on the edges are {few}"
    return ""


def _strange_numbers(model: Model) -> Iterator[str]:
    """What the automaton, its corrected form, the laws or the stays raise, and numbers that cannot be used."""
    sha = model.sha
    if not (isfinite(sha.low) and isfinite(sha.high)):
        yield f"the range {sha.low:g} to {sha.high:g} degC has no end, so nothing could ever leave it; give both limits"
    try:
        check_sha(sha)
        scaled = in_sensor_scale(model).sha
        check_sha(scaled)
        if model.initial is not None:
            check_distribution(model.initial)
        compile_chain(model)
    except ValueError as error:
        yield str(error)
    else:
        # Moments and squares, not the numbers alone: all arithmetic is in variances, and 1e200 squared is no number.
        yield from (f"location {each.name!r}: {_TOO_GREAT}" for each in scaled.locations if not _moments(each))
        if not (model.sensor_sigma >= 0 and isfinite(model.sensor_sigma * model.sensor_sigma)):
            yield f"sensor_sigma is {model.sensor_sigma:g} {model.unit}; it must be at least 0, and its square a number"
    for name, stay in model.semi_markov.items():
        for signal, (centre, sigma) in stay.inputs.items():
            if not (isfinite(centre) and isfinite(sigma) and sigma >= 0):
                what = f"the input {signal!r} in {name!r} is {centre:g} with sigma {sigma:g}"
                yield f"{what}; the mean must be finite and sigma at least 0"
    for horizon, factor in model.calibration.items():
        if not (isfinite(horizon) and horizon > 0 and isfinite(factor) and factor > 0):
            yield f"the calibration at {horizon:g} s is {factor:g}; both must be finite and above 0"


_TOO_GREAT = "the mean or the variance of its law, or the square of its noise, is beyond all numbers"


def _moments(location: Location) -> bool:
    """Whether mean and variance of the location's law, and its noise squared, are finite numbers."""
    law, noise = location.distribution, location.flow.params["noise"]
    try:
        known = (0.0, 0.0) if law is None else (mean(law), variance(law))
    except OverflowError:
        return False
    return all(isfinite(moment) for moment in (*known, noise * noise))
