"""A kind of effect that no plant has, written as one row: every engine must take it from there."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from sim.effects.expressed import compile_held_heat
from sim.effects.kind import BoundLaw, EffectCandidate, EffectKind, Parameter, Role, Roles, UppaalLaw
from sim.effects.kinds import EFFECTS

HUMIDITY = Role("humidity", "Umidita")


HUMIDITY_HEATING = EffectKind(
    name="humidity-heating",
    meaning="heat of the water that condenses from humid air",
    parameters={
        "gain": Parameter(unit="degC/s per percent", rescaled="scaled"),
        "reference": Parameter(unit="percent", low=0.0, high=100.0, rescaled="stays"),
    },
    roles=Roles(needed=(HUMIDITY,)),
    acts="anywhere",
    **compile_held_heat("gain * (humidity - reference)"),
    candidate=EffectCandidate(
        strength="gain",
        sign=1.0,
        experiment="open the windows for an hour at one load",
        look="steam and wet floors beside the machine",
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
