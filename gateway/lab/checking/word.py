"""`decanter model simulate --word`: a timed word run stay by stay, without noise and without clamps."""

from collections.abc import Iterator
from pathlib import Path

from drivers.named_files import endless_number, regular
from gateway.console import CommandResult, Part, Rows, conclude
from gateway.entry import sentences
from sim.effects import in_sensor_scale
from sim.engine import Policy
from sim.lab.formats import find_model
from sim.proof import parse_word, replay
from sim.sha import display_unit

COLUMNS = ("time", "symbol", "location", "seconds", "m", "offset", "entered", "left", "clamped")


def replay_word(directory: str, text_or_file: str, policy: Policy, *, as_json: bool) -> None:
    """Replay a word, given as text or as a file's name, and say whether the model's own range is left."""
    with sentences():
        model = in_sensor_scale(find_model(directory).runnable())
        text = text_or_file
        # Every word has an @; a file's name may have one too.
        if "@" not in text_or_file or Path(text_or_file).is_file():
            try:
                text = regular(Path(text_or_file)).read_text(encoding="utf-8")
                if problem := endless_number(text):
                    raise ValueError(f"{text_or_file}: {problem}")
            except UnicodeDecodeError as error:
                reason = f"byte {error.start} is not UTF-8; give a text file with a timed word"
                raise ValueError(f"{text_or_file}: {reason}") from None
        done = replay(model, parse_word(text), policy)
    low, high, unit = model.sha.low, model.sha.high, display_unit(model.unit)
    outside = done.leaves(low, high)
    data = {
        "model": model.sha.name,
        "range": [low, high],
        "lowest": done.lowest,
        "highest": done.highest,
        "leaves": outside is not None,
        "stays": [{name: getattr(visit, name) for name in COLUMNS} for visit in done.visits],
    }

    def show() -> Iterator[Part]:
        rows = [[getattr(visit, name) for name in COLUMNS] for visit in done.visits]
        yield Rows(f"replay without noise and clamps (s, {unit})", COLUMNS, rows)
        sentence = (
            f"from {done.lowest:.6g} to {done.highest:.6g} {unit}; the model's range is {low:g} to {high:g} {unit}"
        )
        left = f": it is left in {outside.location!r}, in the stay from {outside.time:.6g} s on" if outside else ""
        yield sentence + left

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)
