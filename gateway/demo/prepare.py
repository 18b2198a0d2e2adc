"""What the demonstration runs on: models learned from one part of the data, the other part as the PLC's trace."""

import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.named_files import name_write_errors
from gateway.settings import load_device
from sim.sha import Alphabet, Model, Switch, Trace

LEARN_SHARE = 0.6
"""Of a recorded trace, the share that the model is learned from; the PLC replays the rest."""
LEAST_SCAN_S = 0.02
"""Real seconds that a scan may take at least: below it, two cores cannot carry the PLC and the gateway."""
MOST_SPEED = 100.0
REPLAY_S = 30.0
"""Real seconds that a replay is to take when nobody asks for another time."""
LEAST_REPLAY_S = 5.0
"""Plant seconds that a replay must have: below it there is no room for an outage and a recovery at real speed."""
MIN_SHARE_INSIDE = 0.5
"""Of a signal's readings, the share that a register's range must hold for the register to be meant for it."""
FIRST_REGISTER = 1000
"""Where the signals of a foreign trace begin: above the service registers and the block of the decanter's map."""
PLANT_LIMIT = 80.0
"""degC: the alarm limit of the plant's bearings."""
P_LIMIT = 0.5
"""The chance of reaching the limit that is worth an alarm."""
LEAST_FORECAST_S = 0.3
"""Real seconds between two forecasts at least: one must be made, and used, on a machine that has other work too."""
OUTAGE_SHARE, HEAT_OUTAGE_SHARE = 0.45, 0.2
"""Where the PLC refuses its connections, as a share of the duration: of a replay, and of the live plant's day."""

Report = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoBearing:
    """A temperature that is predicted: its model, the folder's name in which that lies, its alarm limit (degC)."""

    model: Model
    folder: str
    limit: float

    @property
    def temperature(self) -> str:
        """Its tag."""
        return self.model.temperature


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoRun:
    """All files of one demonstration in `folder`, and the figures that its processes need.

    `bearings` are the temperatures that are predicted, the one that the demonstration is about first. `device` is the
    register map; `addresses` is the link's own device file where that is another one. `speed` is plant seconds per real
    second, `period` the scan's in plant seconds.

    With a live plant (`live`, of the draws `seed`) nothing is replayed: `trace` is what the plant does on its own, with
    nobody who acts on the prediction, and `replay` holds that.
    """

    folder: Path
    trace: Trace
    bearings: tuple[DemoBearing, ...]
    device: Path
    plant: Path
    replay: Path
    speed: float
    period: float
    notes: tuple[str, ...]
    link: str = "modbus"
    addresses: Path | None = None
    live: bool = False
    seed: int = 0

    @property
    def model(self) -> Model:
        """The first bearing's model."""
        return self.bearings[0].model

    @property
    def limit(self) -> float:
        """The first bearing's alarm limit (degC)."""
        return self.bearings[0].limit

    @property
    def seconds(self) -> float:
        """Real seconds that the replay takes."""
        return float(self.trace.times[-1] - self.trace.times[0]) / self.speed

    @property
    def forecast_period(self) -> float:
        """Plant seconds between two forecasts."""
        return max(10.0, 5 * self.period, LEAST_FORECAST_S * self.speed)

    @property
    def outage_time(self) -> float:
        """Real seconds from the start to the outage."""
        return (HEAT_OUTAGE_SHARE if self.live else OUTAGE_SHARE) * self.seconds


def split(traces: Sequence[Trace], share: float = LEARN_SHARE) -> tuple[list[Trace], Trace]:
    """The traces up to `share` of all their rows, and the longest piece of what comes after.

    Traces count in the order given; the one in which the share ends is cut there. Raises ValueError when a part would
    be empty.
    """
    budget = share * sum(trace.times.size for trace in traces)
    before: list[Trace] = []
    after: list[Trace] = []
    for trace in traces:
        rows = trace.times.size
        if rows <= budget:
            before.append(trace)
        elif budget >= 1:
            cut = float(trace.times[int(budget)])
            before.append(trace.between(-np.inf, cut))
            after.append(trace.between(cut, np.inf))
        else:
            after.append(trace)
        budget -= rows
    replayed = max(after, key=lambda trace: trace.times.size, default=None)
    if not before or replayed is None or np.ptp(replayed.times) < LEAST_REPLAY_S:
        raise ValueError(
            f"there is too little to learn from the first {100 * share:.0f} % and to replay at least "
            f"{LEAST_REPLAY_S:g} s of the rest; give a longer trace"
        )
    return before, replayed


def choose_limit(training: Sequence[Trace], temperature: str, wanted: float | None) -> tuple[float, str]:
    """The alarm limit (degC) and a sentence when it is not the plant's own."""
    if wanted is not None:
        return wanted, ""
    seen = [trace.signals[temperature] for trace in training if temperature in trace.signals]
    hottest = max((float(np.max(column[np.isfinite(column)], initial=-np.inf)) for column in seen), default=-np.inf)
    if hottest < PLANT_LIMIT:
        return PLANT_LIMIT, ""
    limit = round(hottest * 1.05, 1)
    return limit, (
        f"the part that was learned from reaches {hottest:.1f} degC, above the bearing limit of {PLANT_LIMIT:g} degC: "
        f"the limit of this run is {limit:g} degC (give --limit to choose)"
    )


def pace(trace: Trace, seconds: float | None) -> tuple[Trace, float, float]:
    """(replay, speed, scan period in plant seconds) for `seconds` real seconds at most; a longer trace is cut.

    With None the whole trace is replayed, in REPLAY_S real seconds if MOST_SPEED allows it and longer if not.
    """
    start = float(trace.times[0])
    if seconds is not None:
        trace = trace.between(start, start + seconds * MOST_SPEED)
    steps = np.diff(trace.times)
    sampling = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    speed = float(np.clip(np.ptp(trace.times) / (seconds or REPLAY_S), 1.0, MOST_SPEED))
    return trace, speed, max(round(sampling, 2), round(speed * LEAST_SCAN_S, 2), 0.1)


def suits(device: Path, trace: Trace) -> bool:
    """True if every signal is a tag of the register map and most of its readings lie in the tag's range.

    Single readings outside are the plant's business: the gateway shall see and refuse them.
    """
    tags = {tag.name: tag for tag in load_device(device).tags}
    for name, column in trace.signals.items():
        seen, tag = column[np.isfinite(column)], tags.get(name)
        if tag is None:
            return False
        low, high = -np.inf if tag.low is None else tag.low, np.inf if tag.high is None else tag.high
        if seen.size and np.mean((seen >= low) & (seen <= high)) < MIN_SHARE_INSIDE:
            return False
    return True


def predictable_tags(device: Path, trace: Trace, first: str) -> tuple[str, ...]:
    """The tags to predict: `first`, and every other measured one that the device takes a block of."""
    blocks = [layout.temperature for layout in load_device(device).writebacks]
    measured = {name for name, column in trace.signals.items() if np.isfinite(column).any()}
    return (first, *(tag for tag in blocks if tag is not None and tag != first and tag in measured))


def write_device(trace: Trace, alphabet: Alphabet, units: Mapping[str, str], template: Path, out: Path) -> Path:
    """A register map for the signals of a foreign trace, with the service registers and the block of `template`.

    Switches and two-valued signals become bits, everything else 32-bit floats with the low word first. Raises
    ValueError for a signal that is named like a service register, or beyond what 32 bits hold.
    """
    text = template.read_text(encoding="utf-8")
    head, _, rest = text.partition("[[tags]]")
    tail = "[[tags]]\n" + rest[rest.index('name = "PlcHeartbeat"') :].partition("[[writeback.blocks]]")[0]
    # One block, of whatever is predicted: the template's speaks of the decanter's bearings.
    tail = re.sub(r"(?m)^temperature = .*\n", "", tail)
    service = {tag["name"] for tag in tomllib.loads(tail)["tags"]}
    switches = {channel.signal for channel in alphabet.channels if isinstance(channel, Switch)}
    tags, register = [], FIRST_REGISTER
    for name, column in trace.signals.items():
        seen = column[np.isfinite(column)]
        if name in service:
            raise ValueError(f"the signal {name!r} is named like a register of the PLC's own; rename it in the map")
        if np.any(np.abs(seen) > np.finfo(np.float32).max):
            raise ValueError(f"the signal {name!r} has values that no 32-bit float holds; scale it in the map")
        if not seen.size:
            continue
        two_valued = name in switches or set(np.unique(seen)) <= {0.0, 1.0}
        kind = 'dtype = "bool"\nbit = 0' if two_valued else 'dtype = "float32"\norder = "CDAB"'
        unit = _toml(units.get(name, ""))
        tags.append(f'[[tags]]\nname = {_toml(name)}\naddress = "holding:{register}"\n{kind}\nunit = {unit}\n')
        register += 1 if two_valued else 2
    with name_write_errors(out):
        out.write_text(head + "\n".join(tags) + "\n" + tail, encoding="utf-8")
    return out


def _toml(text: str) -> str:
    """A TOML basic string; JSON's escapes are TOML's, but for characters beyond 16 bits and for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def write_plant(setting: DemoRun, settings: Mapping[str, object]) -> Path:
    """The gateway's configuration: armed on this machine, everything in one folder, over the link of `settings`."""
    rows = "\n".join(f"{key} = {_value(value)}" for key, value in settings.items())
    temperatures = "\n".join(
        f"[[temperature]]\ntag = {_toml(bearing.temperature)}\nmodel = {_toml(bearing.folder)}\n"
        f"limit = {bearing.limit:g}\n"
        for bearing in setting.bearings
    )
    setting.plant.write_text(
        f"""# Written by `decanter demo`: a gateway against a software PLC on this machine.
[device]
heartbeat_period = 0.1

[[device.links]]
name = {_toml(setting.link)}
file = {_toml(str((setting.addresses or setting.device).absolute()))}
{rows}

[scan]
period = {setting.period:g}

{temperatures}
[writeback]
mode = "armed"
armed_by = "decanter demo"
reason = "demonstration against the software PLC on this machine"
minutes = 480

[alarms]
limit = {setting.limit:g}
p_limit = {P_LIMIT:g}

[historian]
path = "historian.sqlite"

[log]
path = "gateway.log.jsonl"

[forecast]
horizons = [60, 300, 900]
period = {setting.forecast_period:g}
""",
        encoding="utf-8",
    )
    return setting.plant


def _value(value: object) -> str:
    """A TOML value: text, a number, true or false."""
    if isinstance(value, bool):
        return str(value).lower()
    return _toml(str(value)) if isinstance(value, str | Path) else repr(value)
