"""Generation in batches that can be interrupted: a case that has its label is done."""

from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.discrepancy.generator import identifier, learn_models, make
from benchmarks.discrepancy.seal import commit, labelled, write_labels
from benchmarks.discrepancy.strata import Spec

Told = Callable[[str], None]


def batches(specs: Sequence[Spec], size: int) -> dict[str, list[Spec]]:
    """Cases that share a clock, `size` at most, by a name that says which they are."""
    by_clock: dict[tuple[str, str, int], list[Spec]] = {}
    for spec in specs:
        by_clock.setdefault((spec.set, spec.stratum, spec.days), []).append(spec)
    return {
        f"{set_}-{stratum}-{part[0].number}-{part[-1].number}": part
        for (set_, stratum, _), group in by_clock.items()
        for part in (group[at : at + size] for at in range(0, len(group), size))
    }


def generate_all(specs: Sequence[Spec], out: Path, *, jobs: int, size: int, told: Told) -> str:
    """Make all cases that are not there yet, and return the hash of all labels in the folder."""
    from joblib import Parallel, delayed

    there = labelled(out)
    left = [spec for spec in specs if identifier(spec) not in there]
    parts = batches(left, size)
    if left:
        told(f"learning the models of the machines of {len(left)} cases")
        learn_models(left, out, jobs)
    done = 0
    work = (delayed(_batch)(name, part, out) for name, part in parts.items())
    for number in Parallel(n_jobs=jobs, return_as="generator_unordered")(work):
        done += number
        told(f"{done} of {len(left)} cases")
    return commit(out)


def _batch(name: str, specs: Sequence[Spec], out: Path) -> int:
    write_labels(out, name, make(specs, out))
    return len(specs)
