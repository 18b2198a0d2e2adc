"""A signal that is made of others, where neither device nor file has it: one law for column maps and device files."""

from collections.abc import Mapping, Sequence
from math import isfinite, prod
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, model_validator

from drivers.tag import DType, Quality, Sample, Tag


class Derived(BaseModel):
    """What a signal is: `signal` > `above` (< `below`), a `constant`, or a `product`.

    A product is `scale` times the signals that it names, in `unit`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    signal: str | None = None
    above: float | None = None
    below: float | None = None
    constant: float | None = None
    product: tuple[str, ...] = ()
    scale: float = 1.0
    unit: str = ""

    @property
    def sources(self) -> tuple[str, ...]:
        """The signals that it is made of."""
        return self.product if self.signal is None else (self.signal,)

    @property
    def is_switch(self) -> bool:
        """Whether it is 1 or 0, and nothing between."""
        return self.signal is not None

    def tag(self, name: str) -> Tag:
        """It as a tag without an address: nothing is asked for it."""
        return Tag(name, "", DType.BOOL if self.is_switch else DType.FLOAT64, unit=self.unit)

    def value(self, values: Sequence[Any]) -> Any:
        """Its value where its sources have these, in their order, numbers or arrays; of a switch whether it is on."""
        if self.constant is not None:
            return self.constant
        if self.signal is None:
            return self.scale * prod(values)
        (source,) = values
        return source > self.above if self.above is not None else source < self.below

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        forms = (self.signal is not None, self.constant is not None, bool(self.product))
        limits = sum(limit is not None for limit in (self.above, self.below))
        if sum(forms) != 1 or limits != (self.signal is not None):
            raise ValueError("give either signal and above, or constant, or product; below may stand for above")
        if len(self.product) == 1:
            raise ValueError("product needs two signals or more")
        if not self.product and self.scale != 1.0:
            raise ValueError("scale belongs to product")
        return self


def with_derived(samples: Mapping[str, Sample], derived: Mapping[str, Derived], now: float) -> dict[str, Sample]:
    """The samples and those that are made of them at `now` (s): each is worth what the worst of its sources is."""
    found = dict(samples)
    for name, law in derived.items():
        sources = [samples[source] for source in law.sources]
        values = [sample.value for sample in sources]
        known = not any(value is None or isinstance(value, str) for value in values)
        value = law.value(values) if known else None
        if not sources:
            found[name] = Sample(name, value, Quality.GOOD, now)
            continue
        worst = max(sources, key=lambda sample: sample.quality)
        quality, reason = worst.quality, f"{worst.tag}: {worst.reason}" if worst.reason else ""
        if value is not None and not isfinite(value):
            value, quality, reason = None, Quality.DECODING_ERROR, f"{' times '.join(law.sources)} is beyond any number"
        found[name] = Sample(
            name,
            value,
            quality,
            min(sample.time for sample in sources),
            sent=min((sample.sent for sample in sources if sample.sent is not None), default=None),
            reason=reason,
        )
    return found
