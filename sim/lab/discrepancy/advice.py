"""What a person does next: what to look at at the machine, and laws to look at where there is no name."""

import re
from collections.abc import Sequence
from itertools import combinations

from sim.lab.discrepancy.diagnosis import (
    CANNOT_TELL,
    CandidateLaw,
    Diagnosis,
    HeatPlace,
    PairOfRivals,
    ProposedExperiment,
    Shift,
)
from sim.lab.discrepancy.fitting import catalogue, rivals
from sim.lab.discrepancy.heat_maps import span
from sim.sha import display_unit

MAX_LISTED = 2
"""Places that are told where nothing has a name."""
MIN_LISTED_SHARE = 0.2
"""Share of the unexplained heat below which a place is none that is told: most of the heat is elsewhere."""


def told_places(places: Sequence[HeatPlace]) -> tuple[HeatPlace, ...]:
    """The places in which enough of the heat lies to speak of a place at all."""
    return tuple(place for place in places if place.share >= MIN_LISTED_SHARE)


def advice_lines(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What to look at at the machine, in the plant's words, the likeliest first; nothing where nothing is wrong."""
    looks = {entry.name: entry.candidate.look for entry in catalogue()}
    looks |= {effect.name: effect.look for effect in diagnosis.effects if effect.look}
    looks_of_rivals = {entry.name: entry.candidate.look for entry in rivals()}
    lines = []
    for effect in diagnosis.effects:
        lines += [f"{looks[name]} ({name})" for name in effect.members if looks.get(name)]
    if diagnosis.verdict == "unexplained":
        for place in told_places(diagnosis.unexplained)[:MAX_LISTED]:
            after = f" {span(*place.seconds)} after {place.after}" if place.after else ""
            with_ = (
                f", with {place.when}" if place.when else f", as {place.correlates} changes" if place.correlates else ""
            )
            lines.append(f"what the machine does in {place.location}{after}{with_}")
        lines += [f"what goes with {law.words or in_words(law.expression)}: {law.experiment}" for law in diagnosis.laws]
        if diagnosis.description:
            first = [tried for tried in diagnosis.candidates if tried.step == 1]
            alike = [tried.name for tried in first[1:] if tried.fate == CANNOT_TELL and tried.name in looks_of_rivals]
            looks_at = "; ".join(dict.fromkeys(looks_of_rivals[name] for name in (first[0].name, *alike)))
            lines = [f"{looks_at} ({diagnosis.description})", *lines]
        if not lines:
            lines.append("what is not recorded yet: no measured signal goes with the gap")
    if not lines and diagnosis.shifts:
        surest = diagnosis.shifts[0]
        lines.append(
            f"what changed since the model was learned in {surest.location} ({surest.parameter} {shown_move(surest)}): "
            "load, grease, cooling, an exchanged part or sensor"
        )
    return tuple(dict.fromkeys(lines))


def shown_move(shift: Shift) -> str:
    """By how much a parameter has moved: a temperature in its unit, with the share where it says something; the others
    as a share, else from where to where."""
    unit = display_unit(shift.unit)
    share = "" if shift.change is None else f"{shift.change:+.0%}"
    if shift.parameter == "target":
        return f"{shift.after - shift.before:+.3g} {unit}" + (f" ({share})" if share else "")
    return share or f"from {shift.before:.2g} to {shift.after:.2g} {unit}"


def overlapping_places(places: Sequence[HeatPlace]) -> tuple[HeatPlace, HeatPlace] | None:
    """Two places of which some heat lies in both, so that their shares do not add up; None where there are none."""
    for one, other in combinations(places, 2):
        meet = one.seconds[0] < other.seconds[1] and other.seconds[0] < one.seconds[1]
        # Two strata of one signal part the location; anything else at the same time is partly the same heat.
        strata = bool(one.when and other.when) and one.correlates == other.correlates
        if one.location == other.location and meet and not strata:
            return one, other
    return None


def overlap_sentence(places: Sequence[HeatPlace]) -> str:
    """That the shares of places overlap, with an example; "" where they do not."""
    both = overlapping_places(places)
    if both is None:
        return ""
    one, other = (place.when or f"{span(*place.seconds)} after {place.after or 'its beginning'}" for place in both)
    return f"These shares overlap and do not add up: in {both[0].location}, {one} and {other} are partly the same heat"


def law_sentence(law: CandidateLaw) -> str:
    """What is to be said of a law: how much goes with it, on how many cycles, and that it is no name."""
    while_ = " while the machine runs" if law.running else ""
    alike = f"; these data cannot tell it from {law.alike[0]}" if law.alike else ""
    return (
        f"not a name: {law.share:.0%} of what is left goes with {law.words or in_words(law.expression)}{while_}, on "
        f"{law.cycles[0]} of {law.cycles[1]} held-out cycles ({law.tried} expressions were tried{alike}); to find out: "
        f"{law.experiment}"
    )


def experiment_lines(proposed: ProposedExperiment) -> tuple[str, ...]:
    """The experiment as a numbered list: what to set, for how long, and what it is expected to tell."""
    times = "" if proposed.repeats == 1 else f", {proposed.repeats} times"
    lines = [f"experiment: {proposed.what}{times}, {proposed.seconds / 3600.0:.1f} h in all"]
    settings = list[str]()
    number = 0
    for each in proposed.steps:
        settings.append(f"{each.signal} = {each.value:g}")
        if each.seconds > 0:
            number += 1
            lines.append(f"  {number}. {', '.join(settings)}; for {each.seconds / 60.0:.0f} min")
            settings = []
    told = [pair for pair in proposed.pairs if pair not in proposed.inseparable]
    lines += [f"  tells {pair.one} from {pair.other} by {pair.nats:.0f} nats{_only_in_rows(pair)}" for pair in told]
    lines += [
        f"  no experiment within the machine's ranges and two days tells {pair.one} from {pair.other}: "
        f"{pair.most:.1f} nats are expected at most, and a name needs {proposed.least:.0f}"
        for pair in proposed.inseparable
    ]
    if any(pair.nats < proposed.needed for pair in told):
        lines.append(f"  a name can be counted on from {proposed.needed:.0f} nats on: it may have to be made again")
    return tuple(lines)


def _only_in_rows(pair: PairOfRivals) -> str:
    """Where rows such as those of the traces would show nothing of a pair: which would; else ""."""
    if pair.rows is None:
        return ""
    return (
        f" only where days and experiment are recorded in rows of {pair.rows:g} s or less: in rows as now one of the "
        "two may be too short to be named, whatever the experiment"
    )


def in_words(expression: str) -> str:
    """The expression with its history and rhythm spelled out."""
    text = re.sub(r"\bevery_(\d+)min_\d\b", r"a rhythm of \1 min", expression)
    text = re.sub(r"\bdaily_(\d+)h\b", r"the time of day (as at \1 h UTC)", text)
    text = re.sub(r"\blag_(\w+)_(15min|1h|4h)\b", r"\1 over the last \2", text)
    text = text.replace("since_stop", "seconds since the stop")
    return re.sub(r"\bsince\b(?! the)", "seconds since the start", text)
