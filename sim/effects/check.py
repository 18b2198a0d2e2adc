"""Whether an automaton can be run: its flows, laws and entry modes, and its effects, by the table of their kinds."""

from sim.effects.kind import EffectKind, Structural
from sim.effects.kinds import effect_kind
from sim.sha import FIXED_PARAMETER, SHA, Effect, check_distribution, check_flow


def check_sha(sha: SHA) -> None:
    """Raises ValueError, naming the location or effect, unless all flows, laws, entry modes and effects can be run."""
    for location in sha.locations:
        try:
            check_flow(location.flow)
            if location.distribution is not None:
                check_distribution(location.distribution)
            if location.entry not in ("parameter", "resample", "none"):
                raise ValueError(f"unknown entry mode {location.entry!r}: known are parameter, resample, none")
            if location.entry == "resample" and location.distribution is None:
                raise ValueError("entry mode 'resample' needs a distribution from which the temperature is drawn")
            if (
                FIXED_PARAMETER in location.flow.params
                and location.entry == "parameter"
                and location.distribution is not None
            ):
                raise ValueError("the flow fixes m and the entry draws it: leave out the flow's m or the distribution")
        except ValueError as error:
            raise ValueError(f"SHA {sha.name!r}, location {location.name!r}: {error}") from None
    check_effects(sha)


def check_effect(effect: Effect) -> None:
    """Raises ValueError, saying what would be right, for an unknown kind, parameters or roles that it cannot use."""
    kind = effect_kind(effect)
    _check_params(effect, kind)
    known = (*kind.required_roles, *kind.optional)
    missing = [role for role in kind.required_roles if not effect.signals.get(role)]
    strange = [role for role in effect.signals if role not in known]
    if missing or strange:
        wrong = f"{missing[0]} is missing" if missing else f"{strange[0]} is unknown"
        roles = [*kind.required_roles, *(f"{role} (optional)" for role in kind.optional)]
        raise ValueError(f"effect {effect.kind!r} takes signals for {', '.join(roles) or 'nothing'}; {wrong}")
    if kind.from_event != bool(effect.event):
        wrong = "counts from no event; leave `event` empty" if effect.event else "needs the event since which it counts"
        raise ValueError(f"effect {effect.kind!r} {wrong}")
    if kind.acts == "everywhere" and effect.locations:
        raise ValueError(f"effect {effect.kind!r} acts everywhere; leave `locations` empty")


def _check_params(effect: Effect, kind: EffectKind) -> None:
    """Raises ValueError for parameters that are missing, unknown, out of range or at odds with one another."""
    missing = [
        name
        for name, each in kind.parameters.items()
        if name not in effect.params and each.default is None and each.role not in effect.signals
    ]
    strange = [name for name in effect.params if name not in kind.parameters]
    if missing or strange:
        wrong = f"{missing[0]} is missing" if missing else f"{strange[0]} is unknown"
        raise ValueError(f"effect {effect.kind!r} takes the parameters {', '.join(kind.parameters)}; {wrong}")
    for name, value in effect.params.items():
        each = kind.parameters[name]
        if not each.holds(value):
            raise ValueError(f"effect {effect.kind!r}: {name} must be {each.words}, got {value:g}")
        if each.whole and value != int(value):
            *most, last = (str(number) for number in range(int(each.low), int(each.high) + 1))
            raise ValueError(f"effect {effect.kind!r}: {name} must be {', '.join(most)} or {last}, got {value:g}")
    wrong = kind.consistent(effect.params)
    if wrong:
        raise ValueError(f"effect {effect.kind!r} {wrong}")


def check_effects(sha: SHA) -> None:
    """Raises ValueError, naming the effect, unless every one can be executed in this automaton."""
    symbols = {edge.symbol for edge in sha.edges}
    features: set[str] = set()
    for effect in sha.effects:
        try:
            check_effect(effect)
        except ValueError as error:
            raise ValueError(f"SHA {sha.name!r}: {error}") from None
        if effect.event and effect.event not in symbols:
            raise ValueError(
                f"SHA {sha.name!r}: effect {effect.kind!r} counts since the event {effect.event!r}, which no edge has; "
                f"known are {', '.join(sorted(symbols)) or 'none'}"
            )
        kind = effect_kind(effect)
        if kind.single and isinstance(kind.law, Structural):
            if kind.law.feature in features:
                raise ValueError(
                    f"SHA {sha.name!r}: the effect {effect.kind!r} stands there twice; one is all it can have"
                )
            features.add(kind.law.feature)
