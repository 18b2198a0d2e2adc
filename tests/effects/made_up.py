"""A kind of effect that no plant has, written as one row: every engine must take it from there."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from sim.effects.kind import (
    BoundLaw,
    EffectCandidate,
    EffectKind,
    HeatBound,
    HeldLaw,
    Parameter,
    Role,
    Roles,
    Signals,
    TextLaw,
    TextWriter,
    UppaalLaw,
)
from sim.effects.kinds import EFFECTS
from sim.sha.automaton import Effect
from sim.sha.trace import Array

HUMIDITY = Role("humidity", "Umidita")


def _condensing(effect: Effect, signals: Signals) -> tuple[Array, Array]:
    humidity = signals[effect.signals["humidity"]]
    return effect.params["gain"] * (humidity - effect.params["reference"]), np.zeros_like(humidity)


def _text(writer: TextWriter, effect: Effect) -> str:
    value, read = writer.read(effect, "humidity")
    gain, reference = (writer.constant(name.upper(), effect.params[name]) for name in ("gain", "reference"))
    return f" + {read} * {gain} * ({value} - {reference})"


HUMIDITY_HEATING = EffectKind(
    name="humidity-heating",
    meaning="heat of the water that condenses from humid air",
    parameters={
        "gain": Parameter(unit="degC/s per percent", rescaled="scaled"),
        "reference": Parameter(unit="percent", low=0.0, high=100.0, rescaled="stays"),
    },
    roles=Roles(needed=(HUMIDITY,)),
    acts="anywhere",
    law=HeldLaw(_condensing),
    bound=HeatBound(lambda _: ()),
    uppaal=TextLaw(_text),
    candidate=EffectCandidate(
        strength="gain",
        sign=1.0,
        experiment="open the windows for an hour at one load",
        shapes=lambda log: [{"reference": log.usual("humidity", running=False)}],
    ),
)


@contextmanager
def known(kind: EffectKind) -> Iterator[None]:
    """The table with one more row, or with another one of that name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(EFFECTS, kind.name, kind)
        yield


def with_part(*, bound: BoundLaw | None = None, uppaal: UppaalLaw | None = None) -> EffectKind:
    """The made-up kind with another bound or text."""
    return replace(HUMIDITY_HEATING, bound=bound or HUMIDITY_HEATING.bound, uppaal=uppaal or HUMIDITY_HEATING.uppaal)
