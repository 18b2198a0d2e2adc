"""The alphabet of events as configuration, and the one encoder that turns samples into events, batch and streaming."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Switch:
    """A two-valued signal: `rising` at 0 -> 1, `falling` at 1 -> 0. `on_change`: it is only sent when it changes."""

    signal: str
    rising: str
    falling: str
    on_change: bool = True


@dataclass(frozen=True, slots=True)
class Bins:
    """A level signal cut at ascending `thresholds`: entering [thresholds[i-1], thresholds[i]) emits `symbols[i]`.

    One symbol more than thresholds; below the first threshold lies the first symbol, whatever the value. A bin is left
    only when its boundary is crossed by more than `hysteresis` (units of the signal).
    """

    signal: str
    thresholds: tuple[float, ...]
    symbols: tuple[str, ...]
    hysteresis: float = 0.0
    on_change: bool = False


@dataclass(frozen=True, slots=True)
class Alphabet:
    """The channels in the order in which simultaneous events are emitted, and what counts as not knowing.

    `gap` (s): no row for longer, or no reading of a channel that is not `on_change` for longer, is unknown. `debounce`
    (s): a new value must hold this long before its event, which carries the time of the confirmation. `uppaal` maps
    symbols to the channel names of UPPAAL (a__0_100 ...).
    """

    channels: tuple[Switch | Bins, ...]
    gap: float = 30.0
    debounce: float = 0.0
    uppaal: tuple[tuple[str, str], ...] = ()


DECANTER = Alphabet(
    channels=(
        Switch("MarciaDecanter", rising="W_ON", falling="W_OFF"),
        Bins("Assorbimento", thresholds=(100.0, 200.0, 300.0), symbols=("A_0", "A_1", "A_2", "A_3")),
    ),
    uppaal=(
        ("W_ON", "W_ON"),
        ("W_OFF", "W_OFF"),
        ("A_0", "a__0_100"),
        ("A_1", "a__100_200"),
        ("A_2", "a__200_300"),
        ("A_3", "a__300_plus"),
    ),
)
