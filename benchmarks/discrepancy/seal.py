"""Sealed labels: what is true of each case, packed away from the cases, with a hash that is published first.

`labels/*.json.gz` hold the truth, `index.json` the cases in an order that tells nothing, `COMMITMENT` the SHA-256 over
all labels. The runner and the rivals read the index alone; the scorer opens the labels, and refuses them
when they are not those that were committed to.
"""

import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

INDEX, COMMITMENT, LABELS, CONFIG = "index.json", "COMMITMENT", "labels", "case.json"


@dataclass(frozen=True, slots=True)
class Label:
    """The truth of one case: its spec, the strengths and signal-to-noise ratios of its effects by name.

    `outside`: those of its effects that no name of the vocabulary stands for. `baseline_gap`: what the best baseline
    leaves of the plant without effects and disturbances, over the sensor's sigma (nothing is clean when it is large).
    `floor` (degC): free-run error of the true plant over the last 30 % of the time, for its disturbances and sensor.
    """

    case: str
    spec: Mapping[str, Any]
    strengths: Mapping[str, float]
    ratios: Mapping[str, float]
    outside: tuple[str, ...]
    baseline_gap: float
    sensor: float
    floor: float
    machine: str

    @property
    def truth(self) -> frozenset[str]:
        """The names that a perfect answer has."""
        return frozenset(self.spec["effects"]) - frozenset(self.outside)

    @property
    def ratio(self) -> float:
        """The smallest ratio of its effects, infinite for a clean case."""
        return min(self.ratios.values(), default=float("inf"))

    @staticmethod
    def write_config(folder: Path, config: Mapping[str, Any]) -> None:
        """What the runner may know of a case."""
        (folder / CONFIG).write_text(json.dumps(config, indent=1) + "\n", encoding="utf-8")


def write_labels(out: Path, batch: str, labels: Iterable[Label]) -> None:
    """Pack the labels of one batch; the file appears whole or not at all."""
    folder = out / LABELS
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps([asdict(label) for label in labels], sort_keys=True).encode()
    draft = folder / f".{batch}.draft"
    draft.write_bytes(gzip.compress(content, mtime=0))
    draft.replace(folder / f"{batch}.json.gz")


def labelled(out: Path) -> frozenset[str]:
    """The cases that are finished."""
    return frozenset(label.case for label in _read(out))


def commitment(out: Path) -> str:
    """SHA-256 over all labels, whatever their batches and order."""
    return sha256(
        "".join(sorted(json.dumps(asdict(label), sort_keys=True) for label in _read(out))).encode()
    ).hexdigest()


def labels_of(out: Path) -> dict[str, Label]:
    """The labels by case, for who makes the cases and judges them in one go; none in a new folder."""
    return {label.case: label for label in _read(out)}


def commit(out: Path) -> str:
    """Write the index and the hash of the labels; returns the hash."""
    cases = sorted(labelled(out))
    (out / INDEX).write_text(json.dumps(cases) + "\n", encoding="utf-8")
    digest = commitment(out)
    (out / COMMITMENT).write_text(digest + "\n", encoding="utf-8")
    return digest


def index(out: Path) -> list[str]:
    """The cases of a folder. Raises ValueError when it holds none."""
    try:
        return list(json.loads((out / INDEX).read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise ValueError(f"{out}: there is no {INDEX}; make the cases first (generate --out {out})") from None


def committed(out: Path) -> str:
    """The published hash. Raises ValueError when there is none."""
    try:
        return (out / COMMITMENT).read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        raise ValueError(f"{out}: there is no {COMMITMENT}; make the cases first (generate --out {out})") from None


def opened(out: Path, expected: str) -> dict[str, Label]:
    """The labels by case. Raises ValueError unless they are those of the hash `expected`."""
    found = commitment(out)
    if found != expected:
        raise ValueError(
            f"{out}: the labels hash to {found[:12]}, the runs were made under {expected[:12]}; they are not the "
            "labels that were committed to; remove the results and run the cases again if cases were added on purpose"
        )
    return labels_of(out)


def _read(out: Path) -> Sequence[Label]:
    labels = []
    for path in sorted((out / LABELS).glob("*.json.gz")):
        for plain in json.loads(gzip.decompress(path.read_bytes())):
            labels.append(Label(**{**plain, "outside": tuple(plain["outside"])}))
    return labels
