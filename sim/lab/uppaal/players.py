"""The templates beside the machine: the event player, the player of the inputs, the structure for the compatibility."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from sim.lab.uppaal.document import Arrow, Template, TemplateLocation, number
from sim.lab.uppaal.replay import InputReadings
from sim.lab.uppaal.words import FreshNames
from sim.sha import Array

VALUES_PER_LINE = 12


def array(kind: str, name: str, values: Sequence[str]) -> str:
    """`const kind name[n] = {...};`, wrapped."""
    rows = [", ".join(values[first : first + VALUES_PER_LINE]) for first in range(0, len(values), VALUES_PER_LINE)]
    return f"const {kind} {name}[{len(values)}] = {{\n    " + ",\n    ".join(rows) + "\n};"


def event_arrays(symbols: Sequence[str], times: Sequence[float] | None, ids: Mapping[str, int]) -> str:
    """The arrays EVENTS and, for a timed replay, EVENT_TIMES; one unused entry where there is no event."""
    codes = [str(ids[symbol]) for symbol in symbols] or ["-1"]
    declared = [f"const int N_E = {len(symbols)};", array("int", "EVENTS", codes)]
    if times is not None:
        declared += [
            "// Cumulative seconds since the start, against a clock `time` that nothing resets.",
            array("double", "EVENT_TIMES", [number(time) for time in times] or ["0.0"]),
        ]
    return "\n".join(declared)


def player(channels: Mapping[str, str], ids: Mapping[str, int], symbols: Iterable[str], *, timed: bool) -> Template:
    """The event player `Player`: sends the channel of each event in turn, at its time (timed) or as soon as taken."""
    used = sorted(set(symbols), key=lambda symbol: ids[symbol])
    choose = TemplateLocation("Choose", kind="committed")
    wait = (
        TemplateLocation("Wait", invariant="time <= EVENT_TIMES[next_i]")
        if timed
        else TemplateLocation("Wait", kind="urgent")
    )
    due = "time >= EVENT_TIMES[next_i] && " if timed else ""
    arrows = [
        Arrow("Choose", "Wait", guard="next_i < N_E"),
        Arrow("Choose", "Done", guard="next_i == N_E"),
        *(
            Arrow(
                "Wait", "Choose", f"{due}EVENTS[next_i] == {ids[symbol]}", f"{channels[symbol]}!", "next_i = next_i + 1"
            )
            for symbol in used
        ),
    ]
    declared = "// The index of the event that comes next.\nint next_i = 0;"
    if timed:
        declared += "\n// Never reset: the seconds since the start.\nclock time;"
    return Template("Player", declared, (choose, wait, TemplateLocation("Done")), tuple(arrows), "Choose")


def input_declarations(readings: InputReadings, inputs: Mapping[str, tuple[str, str]]) -> str:
    """The input signals' variables and, where readings come, the arrays of their held values."""
    lines = ["// The inputs of driven flows: each reading is held until the next; known = 0 before the first one."]
    for signal, (value, known) in inputs.items():
        lines.append(f"double {value} = {number(readings.first.get(signal, 0.0))};")
        lines.append(f"int {known} = {int(signal in readings.first)};")
    if readings.times.size:
        lines.append(f"const int N_R = {readings.times.size};")
        lines.append(array("double", "READING_TIMES", [number(time) for time in readings.times.tolist()]))
        for signal, column in _columns(readings, inputs).items():
            lines.append(array("double", f"READINGS_{inputs[signal][0]}", [number(each) for each in column.tolist()]))
            lines.append(f"const int FIRST_{inputs[signal][0]} = {int(np.isnan(readings.values[signal]).sum())};")
    return "\n".join(lines)


def _columns(readings: InputReadings, inputs: Mapping[str, tuple[str, str]]) -> dict[str, Array]:
    """The signals that have readings; NaN (not read yet) becomes 0, which its known flag hides."""
    return {signal: np.nan_to_num(readings.values[signal]) for signal in inputs if signal in readings.values}


def input_player(readings: InputReadings, inputs: Mapping[str, tuple[str, str]]) -> Template | None:
    """The player `Inputs` of the held readings; None where none comes after the start."""
    if not readings.times.size:
        return None
    updates = []
    for signal in _columns(readings, inputs):
        value, known = inputs[signal]
        updates.append(f"{value} = READINGS_{value}[next_r]")
        updates.append(f"{known} = (next_r >= FIRST_{value} ? 1 : 0)")
    places = (
        TemplateLocation("Choose", kind="committed"),
        TemplateLocation("Wait", invariant="time <= READING_TIMES[next_r]"),
        TemplateLocation("Done"),
    )
    arrows = (
        Arrow("Choose", "Wait", guard="next_r < N_R"),
        Arrow("Choose", "Done", guard="next_r == N_R"),
        Arrow("Wait", "Choose", "time >= READING_TIMES[next_r]", update=", ".join([*updates, "next_r = next_r + 1"])),
    )
    return Template(
        "Inputs", "int next_r = 0;\n// Never reset: the seconds since the start.\nclock time;", places, arrows, "Choose"
    )


def structure(
    locations: Sequence[str], names: FreshNames, moves: Iterable[tuple[str, str, str]], initial: str
) -> Template:
    """The automaton without clocks: locations and edges, for the compatibility question."""
    places = tuple(TemplateLocation(names.locations[name]) for name in locations)
    arrows = tuple(
        Arrow(names.locations[source], names.locations[target], sync=f"{channel}?") for source, channel, target in moves
    )
    return Template("Machine", "", places, arrows, names.locations[initial])
