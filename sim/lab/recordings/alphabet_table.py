"""An alphabet from TOML tables: channels in order, long rows of bins in short form, faults named by their key."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.settings import first_sentence
from sim.lab.recordings.auto_thresholds import AutoBins, AutoGap
from sim.sha import DECANTER, Alphabet, Bins, Switch, check_alphabet


class _AlphabetPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)


class _EvenSteps(_AlphabetPart):
    """first, first + step, ... last."""

    first: float
    last: float
    step: Annotated[float, Field(gt=0)]


class _Numbered(_AlphabetPart):
    """The lowest bin's symbol, then prefix + 0, 1, 2 ... for the bins above it."""

    lowest: str
    prefix: str


class _SwitchTable(_AlphabetPart):
    kind: Literal["switch"]
    signal: str
    rising: str
    falling: str
    on_change: bool = True


class _BinsTable(_AlphabetPart):
    kind: Literal["bins"]
    signal: str
    thresholds: tuple[float, ...] | _EvenSteps | Literal["auto"] = "auto"
    symbols: tuple[str, ...] | _Numbered | None = None
    hysteresis: float | None = None
    on_change: bool = False


class _AlphabetTable(_AlphabetPart):
    channels: tuple[Annotated[_SwitchTable | _BinsTable, Field(discriminator="kind")], ...]
    gap: Annotated[float, Field(gt=0)] | None = None
    debounce: Annotated[float, Field(ge=0)] = 0.0
    uppaal: dict[str, str] = {}


def _channel(table: _SwitchTable | _BinsTable, prefix: str) -> Switch | Bins:
    if isinstance(table, _SwitchTable):
        return Switch(table.signal, table.rising, table.falling, table.on_change)
    thresholds, symbols, hysteresis = table.thresholds, table.symbols, table.hysteresis or 0.0
    if thresholds == "auto":
        if isinstance(symbols, tuple):
            raise ValueError(
                f"the channel {table.signal!r} has thresholds = 'auto', so nobody knows how many symbols it needs; "
                "give them as {lowest, prefix} or leave them out"
            )
        lowest, prefix = ("", prefix) if symbols is None else (symbols.lowest, symbols.prefix)
        return AutoBins(
            table.signal,
            (),
            (lowest or f"{prefix}0",),
            hysteresis,
            table.on_change,
            prefix=prefix,
            lowest=lowest,
            own_hysteresis=table.hysteresis is not None,
        )
    if isinstance(thresholds, _EvenSteps):
        first, last, step = thresholds.first, thresholds.last, thresholds.step
        count = (last - first) / step
        # Steps of 0.1 hardly ever come out whole in floating point; a file that means a million bins is a mistake.
        if not 0 <= count <= 100_000 or abs(count - round(count)) > 1e-9:
            raise ValueError(f"thresholds from {first:g} to {last:g} are no whole steps of {step:g}")
        thresholds = tuple(first + index * step for index in range(round(count) + 1))
    if symbols is None:
        symbols = tuple(f"{prefix}{index}" for index in range(len(thresholds) + 1))
    elif isinstance(symbols, _Numbered):
        symbols = (symbols.lowest, *(f"{symbols.prefix}{index}" for index in range(len(thresholds))))
    return Bins(table.signal, thresholds, symbols, hysteresis, table.on_change)


DECANTER_AUTO = AutoGap(
    channels=(DECANTER.channels[0], AutoBins("Assorbimento", (), ("A_0",), prefix="A_")), gap=DECANTER.gap
)
"""The alphabet of a map that names none: the decanter's signals, with the levels of whatever motor it is."""


def alphabet_from_table(table: Mapping[str, object], where: str) -> Alphabet:
    """The alphabet that a TOML table describes.

    `channels` is a list of tables: `{kind = "switch", signal, rising, falling, on_change}` or `{kind = "bins", signal,
    thresholds, symbols, hysteresis, on_change}`, where thresholds may be `{first, last, step}` or "auto" (the readings
    decide when traces are loaded, which is what happens without any) and symbols `{lowest, prefix}` (without any: A_0,
    A_1 ... for the first such channel, B_0 ... for the second); then `gap` (s; without it five of the recording's own
    steps, 30 s at least) and `debounce` in seconds and `uppaal`, symbol = channel name. Raises ValueError with one
    sentence that begins with `where` (the file and key).
    """
    try:
        parsed = _AlphabetTable.model_validate(dict(table))
        channels: list[Switch | Bins] = []
        for part in parsed.channels:
            before = sum(isinstance(channel, Bins) for channel in channels)
            channels.append(_channel(part, f"{chr(ord('A') + before)}_"))
        kind = AutoGap if parsed.gap is None else Alphabet
        alphabet = kind(
            channels=tuple(channels),
            gap=parsed.gap or DECANTER.gap,
            debounce=parsed.debounce,
            uppaal=tuple(parsed.uppaal.items()),
        )
        check_alphabet(alphabet)
    except ValidationError as error:
        raise ValueError(first_sentence(_AlphabetTable, error, where)) from None
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return alphabet


def alphabet_to_table(alphabet: Alphabet) -> dict[str, object]:
    """The table from which `alphabet_from_table` makes the same alphabet; plain values for TOML or JSON."""
    channels: list[dict[str, object]] = []
    for channel in alphabet.channels:
        if isinstance(channel, Switch):
            table: dict[str, object] = {"kind": "switch", "rising": channel.rising, "falling": channel.falling}
        elif isinstance(channel, AutoBins):
            table = {"kind": "bins", "thresholds": "auto"}
            table |= {"symbols": {"lowest": channel.symbols[0], "prefix": channel.prefix}} if channel.lowest else {}
            table |= {"hysteresis": channel.hysteresis} if channel.own_hysteresis else {}
        else:
            table = {"kind": "bins", "thresholds": list(channel.thresholds), "symbols": list(channel.symbols)}
            table["hysteresis"] = channel.hysteresis
        channels.append({**table, "signal": channel.signal, "on_change": channel.on_change})
    return {"channels": channels, "gap": alphabet.gap, "debounce": alphabet.debounce, "uppaal": dict(alphabet.uppaal)}
