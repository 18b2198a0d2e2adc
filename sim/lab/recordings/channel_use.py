"""Whether the alphabet fits the traces: a channel that never speaks teaches nothing, nor does one of a single bin."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.lab.recordings.auto_thresholds import Levels, find_levels
from sim.lab.recordings.load_report import TraceError, list_names
from sim.sha import Alphabet, Bins, Switch, Trace

MAX_BIN_SHARE = 0.95
"""Share of a signal's readings in one bin beyond which the other bins are learned from next to nothing."""


@dataclass(frozen=True, slots=True)
class ChannelUse:
    """A channel of the alphabet in some traces: its `events`, `readings`, and the `share` of its fullest bin `symbol`.

    `sentence` says what is wrong with it and what would be right; it is empty where nothing is. `proposal` are the
    thresholds that the readings themselves suggest.
    """

    signal: str
    events: int
    readings: int
    symbol: str = ""
    share: float = 0.0
    proposal: tuple[float, ...] = ()
    sentence: str = ""


def channel_uses(traces: Sequence[Trace], alphabet: Alphabet) -> tuple[ChannelUse, ...]:
    """How the encoded traces use each channel, in alphabet order.

    Raises TraceError where no trace has any signal of the alphabet: there is nothing to learn events from.
    """
    present = sorted({name for trace in traces for name in trace.signals})
    wanted = [channel.signal for channel in alphabet.channels]
    if not set(wanted) & set(present):
        raise TraceError(
            f"the alphabet watches {list_names(wanted)}, and the traces have none of them but {list_names(present)}; "
            "in the "
            f"column map, name the columns in [signals] so, or give an [alphabet] whose channels watch what is there: "
            f"{example(alphabet, present)}"
        )
    events = Counter(event.symbol for trace in traces for event in trace.events)
    return tuple(
        _switch_use(traces, channel, events, present)
        if isinstance(channel, Switch)
        else _bins_use(traces, channel, events, alphabet, present)
        for channel in alphabet.channels
    )


def example(alphabet: Alphabet, present: Sequence[str]) -> str:
    """The alphabet as a map has it, with the user's own signals to choose from in place of those that are absent."""
    known = "|".join(present[:8])
    texts = []
    for channel in alphabet.channels:
        signal = channel.signal if channel.signal in present else known
        if isinstance(channel, Switch):
            texts.append(
                f'{{kind = "switch", signal = "{signal}", rising = "{channel.rising}", falling = "{channel.falling}"}}'
            )
        else:
            texts.append(f'{{kind = "bins", signal = "{signal}", thresholds = "auto"}}')
    return f"channels = [{', '.join(texts)}]"


def _absent(signal: str, present: Sequence[str]) -> ChannelUse:
    return ChannelUse(
        signal,
        0,
        0,
        sentence=f"{signal}: no trace has this signal, so the model never hears of it; the signals are "
        f"{list_names(present)}: name one of them {signal} in the column map, or leave the channel out of its "
        "[alphabet]",
    )


def _switch_use(traces: Sequence[Trace], channel: Switch, events: Counter[str], present: Sequence[str]) -> ChannelUse:
    readings = sum(int(np.isfinite(t.signals[channel.signal]).sum()) for t in traces if channel.signal in t.signals)
    signal, count = channel.signal, events[channel.rising] + events[channel.falling]
    if signal not in present:
        return _absent(signal, present)
    sentence = ""
    if not events[channel.rising]:
        never = "has no event at all" if not count else f"is never on ({channel.rising} never happens)"
        sentence = (
            f"{signal} {never} in {readings} readings: all that was recorded counts as standstill; correct its column, "
            "its words, or the value above which the column map derives it"
        )
    return ChannelUse(signal, count, readings, sentence=sentence)


def _bins_use(
    traces: Sequence[Trace], channel: Bins, events: Counter[str], alphabet: Alphabet, present: Sequence[str]
) -> ChannelUse:
    signal, count = channel.signal, sum(events[symbol] for symbol in channel.symbols)
    if signal not in present:
        return _absent(signal, present)
    columns = [trace.signals[signal] for trace in traces if signal in trace.signals]
    values = np.concatenate(columns)
    values = values[np.isfinite(values)]
    if not values.size:
        return ChannelUse(signal, count, 0, sentence=f"{signal} has no reading that can be used; correct its column")
    filled = np.bincount(np.searchsorted(channel.thresholds, values, side="right"), minlength=len(channel.symbols))
    fullest = int(filled.argmax())
    share = float(filled[fullest] / values.size)
    proposal = find_levels(traces, signal, alphabet.gap)
    sentence = ""
    if share > MAX_BIN_SHARE and (channel.thresholds or proposal.thresholds):
        cuts = ", ".join(f"{cut:g}" for cut in channel.thresholds) or "none"
        low, high = np.quantile(values, (0.01, 0.99))
        sentence = (
            f"{signal}: {share:.1%} of {values.size} readings lie in one bin, {channel.symbols[fullest]} (thresholds "
            f"{cuts}; the readings go from {low:.4g} to {high:.4g}): what happens in the other bins is not learned but "
            f"borrowed; {_advice(proposal)}"
        )
    return ChannelUse(
        signal,
        count,
        values.size,
        symbol=channel.symbols[fullest],
        share=share,
        proposal=proposal.thresholds,
        sentence=sentence,
    )


def _advice(proposal: Levels) -> str:
    if not proposal.thresholds:
        return (
            "its readings scatter as much from one to the next as they do in all, or dwell at one level only: no "
            "threshold parts them; leave the channel out, or record the machine at other loads"
        )
    cuts = ", ".join(f"{cut:g}" for cut in proposal.thresholds)
    more = f", hysteresis = {proposal.hysteresis:g}" if proposal.hysteresis else ""
    return f'its own levels suggest thresholds = [{cuts}]{more}; or write thresholds = "auto" in the column map'
