"""Which traces a model was trained on: an error on these is no forecast of its error on others."""

from collections.abc import Sequence
from typing import Literal

from sim.sha import Model, Trace, content_hash, joint_hash

Seen = Literal["no", "content", "name", "unknown"]
"""Whether a model was trained on a trace: its content proves it, or only its name says so; "unknown" where the model
does not say what it was learned from."""
TRAINED_ON: tuple[Seen, ...] = ("content", "name")


def seen_traces(model: Model, traces: Sequence[Trace]) -> dict[str, Seen]:
    """Each trace's name with the answer.

    A model keeps the hash of every trace that had a part in it. Models of earlier releases have one hash over all their
    training traces: it proves the content where the traces with known names, all traces, or one of them alone, have
    it. A known name alone is a warning, since its content may differ.
    """
    origin = model.provenance
    if not (origin.data_hash or origin.traces):
        return {trace.name: "unknown" for trace in traces}
    seen: dict[str, Seen] = {trace.name: "name" if trace.name in origin.traces else "no" for trace in traces}
    if origin.contents:
        proven = [trace for trace in traces if content_hash(trace) in origin.contents]
    else:
        named = [trace for trace in traces if seen[trace.name] == "name"]
        groups = (named, list(traces), *([trace] for trace in traces))
        proven = next((group for group in groups if group and joint_hash(group) == origin.data_hash), [])
        if proven:
            seen = dict.fromkeys(seen, "no")
    return seen | {trace.name: "content" for trace in proven}
