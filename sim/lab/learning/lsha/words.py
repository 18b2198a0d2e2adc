"""Words of the traces and what is remembered of them: the finest deterministic automaton, and coarser views of it.

A word is the sequence of symbols since nothing was known (the trace's begin or an UNKNOWN). Segment(w) are the samples
from the last event of w to the next one, over all traces that begin with w. Words that few stretches begin with have
little evidence, so they fall back on the default hypothesis: words with the same memory are one class.

- `context`: the last announced value of each channel;
- `direction`: the context, and whether the last level that moved rose or fell;
- `previous`: the context, and which channel moved last, from which value;
- `word`: all of it. Nothing is taken for granted then: which words lead to one location is for the queries alone.

Each memory is computed from itself and the next symbol, so every automaton of such classes is deterministic.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim.lab.learning import SWITCH_STEPS, Context, Indices, LearningError, announcements, labels, shared_name
from sim.lab.learning.lsha.settings import Memory
from sim.sha import SHA, UNKNOWN, Alphabet, Array, Edge, Flow, Location, Switch, Trace

Word = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class WordHistory:
    """What is remembered at most: the context, the direction of the last level that moved (-1, 0, 1), the last move.

    `moved` is (channel, value before it), None before anything moved. `node` is the number of the word itself where
    enough stretches begin with it, else -1; `word` is that number for every word, -1 where classes of words are meant.
    """

    context: Context
    direction: int = 0
    moved: tuple[int, int | None] | None = None
    node: int = -1
    word: int = -1


@dataclass(frozen=True, slots=True)
class Meaning:
    """The alphabet as a table: symbol -> (channel, value), and which channels are levels."""

    alphabet: Alphabet
    symbols: Mapping[str, tuple[int, int]]
    levels: tuple[bool, ...]

    def extend_history(self, history: WordHistory, symbol: str, node: int = -1, word: int = -1) -> WordHistory:
        """What is remembered once `symbol` has happened."""
        channel, value = self.symbols[symbol]
        before = history.context[channel]
        context = (*history.context[:channel], value, *history.context[channel + 1 :])
        direction, moved = history.direction, history.moved
        if value != before:
            moved = (channel, before)
            if self.levels[channel] and before is not None:
                direction = 1 if value > before else -1
        return WordHistory(context, direction, moved, node, word)


def meaning(alphabet: Alphabet) -> Meaning:
    """The table of an alphabet's symbols."""
    symbols = {
        symbol: (channel, value)
        for channel, each in enumerate(alphabet.channels)
        for value, symbol in enumerate(announcements(each))
    }
    return Meaning(alphabet, symbols, tuple(not isinstance(each, Switch) for each in alphabet.channels))


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceWords:
    """The finest automaton of some traces: its states are numbered from 0, the state in which nothing is known.

    `edges` counts how often each (state, symbol) was taken and says where it led. `first` is where each state was seen
    first: trace and number of its events. `tree` is the tree of words, its nodes numbered from 1 on: (node before,
    symbol) of each.
    """

    meaning: Meaning
    states: tuple[WordHistory, ...]
    edges: Mapping[tuple[int, str], tuple[int, int]]
    first: tuple[tuple[str, int], ...]
    tree: tuple[tuple[int, str], ...]

    def node_word(self, node: int) -> Word:
        """The word of a node of the tree; 0 is the empty one."""
        word: list[str] = []
        while node > 0:
            node, symbol = self.tree[node - 1]
            word.append(symbol)
        return tuple(reversed(word))

    @property
    def events(self) -> int:
        """How many events all words have in all."""
        return sum(count for _, count in self.edges.values())

    @property
    def sha(self) -> SHA:
        """The automaton with constant flows, by which `free_runs` follows traces."""
        flow = Flow("constant", {"noise": 0.0})
        locations = tuple(Location(str(number), flow, entry="none") for number in range(len(self.states)))
        edges = [Edge(str(source), symbol, str(target)) for (source, symbol), (target, _) in self.edges.items()]
        return SHA("words", locations, tuple(edges), "0")


def build_words(traces: Sequence[Trace], alphabet: Alphabet, n_min: int) -> TraceWords:
    """The finest automaton that follows the encoded traces: every word is a state.

    Words that `n_min` stretches begin with are rows of their own under every memory. Raises LearningError, naming trace
    and event, for a symbol that the alphabet does not have.
    """
    table = meaning(alphabet)
    stretches = [stretch for trace in traces for stretch in _stretches(trace, table)]
    nodes, counts = _tree([word for _, _, word in stretches])
    start = WordHistory((None,) * len(alphabet.channels))
    number: dict[WordHistory, int] = {start: 0}
    first = [(traces[0].name, 0)]
    edges: dict[tuple[int, str], tuple[int, int]] = {}
    for name, offset, word in stretches:
        here, history, node = 0, start, 0
        for length, symbol in enumerate(word, 1):
            node = nodes[node, symbol]
            # What is remembered follows from what was remembered before and the symbol alone, or the automaton would
            # not be deterministic: what goes on from a rare word is rare as well.
            history = table.extend_history(history, symbol, node if counts[node - 1] >= n_min else -1, node)
            target = number.setdefault(history, len(number))
            if target == len(first):
                first.append((name, offset + length))
            _, count = edges.get((here, symbol), (target, 0))
            edges[here, symbol] = (target, count + 1)
            here = target
    return TraceWords(meaning=table, states=tuple(number), edges=edges, first=tuple(first), tree=tuple(nodes))


def _stretches(trace: Trace, table: Meaning) -> list[tuple[str, int, Word]]:
    """(trace, number of events before it, word) of each stretch between UNKNOWNs."""
    stretches: list[tuple[str, int, Word]] = []
    begin = 0
    symbols = [event.symbol for event in trace.events]
    for number, symbol in enumerate([*symbols, UNKNOWN]):
        if symbol == UNKNOWN:
            if number > begin:
                stretches.append((trace.name, begin, tuple(symbols[begin:number])))
            begin = number + 1
        elif symbol not in table.symbols:
            raise LearningError(
                f"trace {trace.name!r}: event {number} is {symbol!r}, which the alphabet does not have; encode the "
                "trace with the alphabet that is learned with"
            )
    return stretches


def _tree(words: Sequence[Word]) -> tuple[dict[tuple[int, str], int], list[int]]:
    """((node, symbol) -> node of the tree of all words, how many stretches begin with each); 0 is the empty word.

    Nodes are numbered by the length of their words, and by what the words are, whoever says them.
    """
    nodes: dict[tuple[int, str], int] = {}
    often: list[int] = []
    front = {0: list(words)}
    depth = 0
    while front:
        grown: dict[int, list[Word]] = {}
        for node, through in front.items():
            following: dict[str, list[Word]] = {}
            for word in through:
                if len(word) > depth:
                    following.setdefault(word[depth], []).append(word)
            for symbol in sorted(following):
                nodes[node, symbol] = len(nodes) + 1
                often.append(len(following[symbol]))
                grown[len(nodes)] = following[symbol]
        front, depth = grown, depth + 1
    return nodes, often


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Where classes of words lie: `context` (C, q), NaN for a channel that is not known, and `direction` (C,)."""

    context: Array
    direction: Array


def coordinates(keys: Sequence[WordHistory]) -> Coordinates:
    """The coordinates of some classes."""
    nan = float("nan")
    context = [[nan if value is None else value for value in key.context] for key in keys]
    return Coordinates(np.array(context, dtype=float), np.array([key.direction for key in keys], dtype=float))


@dataclass(frozen=True, slots=True)
class Classes:
    """The words seen through one memory: C classes with observed edges, deterministic.

    `of_state` (S,) is the class of each state of the finest automaton, `keys` (C,) what its words share (`node` or
    `word` only where a class is one word), `edges` (C,) symbol -> class.
    """

    memory: Memory
    of_state: Indices
    keys: tuple[WordHistory, ...]
    edges: tuple[Mapping[str, int], ...]
    meaning: Meaning
    coordinates: Coordinates
    _near: dict[int, list[int]] = field(default_factory=dict, compare=False, repr=False)

    def __len__(self) -> int:
        return len(self.keys)

    def nearest_classes(self, row: int) -> list[int]:
        """All classes by how near they are to one of them; kept, since it is asked often."""
        if row not in self._near:
            where = self.coordinates
            here = Coordinates(where.context[row : row + 1], where.direction[row : row + 1])
            self._near[row] = np.argsort(class_distances(here, where, self.meaning)[0], kind="stable").tolist()
        return self._near[row]


def build_classes(words: TraceWords, memory: Memory) -> Classes:
    """The states of the finest automaton joined where `memory` does not tell them apart; class 0 knows nothing."""
    number: dict[WordHistory, int] = {}
    of_state = [number.setdefault(limit_history(state, memory), len(number)) for state in words.states]
    edges: list[dict[str, int]] = [{} for _ in number]
    for (source, symbol), (target, _) in words.edges.items():
        edges[of_state[source]][symbol] = of_state[target]
    keys = tuple(number)
    return Classes(
        memory=memory,
        of_state=np.array(of_state, dtype=np.intp),
        keys=keys,
        edges=tuple(edges),
        meaning=words.meaning,
        coordinates=coordinates(keys),
    )


def switch_positions(keys: Sequence[WordHistory], table: Meaning) -> list[tuple[int | None, ...]]:
    """(C,) where the switches stand after the words of each class; None for one that is not known."""
    return [tuple(value for value, level in zip(key.context, table.levels, strict=True) if not level) for key in keys]


def class_distances(ones: Coordinates, others: Coordinates, table: Meaning) -> Array:
    """(C, D) how far classes are from each other, as `structure.distance` counts, another direction like a switch."""
    total = np.zeros((ones.direction.size, others.direction.size))
    for channel, level in enumerate(table.levels):
        a, b = ones.context[:, channel, None], others.context[None, :, channel]
        away = np.abs(a - b) if level else SWITCH_STEPS * (a != b)
        both = np.isnan(a) & np.isnan(b)
        total += np.where(np.isnan(a) | np.isnan(b), np.where(both, 0.0, 1.0), away)
    turn, other_turn = ones.direction[:, None], others.direction[None, :]
    unknown = (turn == 0) | (other_turn == 0)
    return np.asarray(total + np.where(turn == other_turn, 0.0, np.where(unknown, 1.0, SWITCH_STEPS)))


def limit_history(history: WordHistory, memory: Memory) -> WordHistory:
    """A history with only what `memory` keeps; a word that is a state of its own keeps its number."""
    if memory == "word":
        return WordHistory(history.context, word=history.word)
    return WordHistory(
        history.context,
        history.direction if memory == "direction" else 0,
        history.moved if memory == "previous" else None,
        history.node,
    )


def class_word(key: WordHistory, words: TraceWords) -> Word | None:
    """The word that a class consists of; None for a class of many words."""
    node = max(key.node, key.word)
    return words.node_word(node) if node > 0 else None


def describe_class(key: WordHistory, alphabet: Alphabet) -> str:
    """A class in words: "ON/200-300", "ON/200-300 rising", "ON/200-300 after 100-200"."""
    return describe_shared([key], alphabet)


def describe_shared(keys: Sequence[WordHistory], alphabet: Alphabet) -> str:
    """What the words of several classes have in common: "ON", "ON/100-300", "ON/200-300 rising"."""
    text = shared_name([key.context for key in keys], alphabet)
    directions, moves = {key.direction for key in keys}, {key.moved for key in keys}
    if len(directions) == 1 and (direction := directions.pop()):
        text += " rising" if direction > 0 else " falling"
    if len(moves) == 1 and (moved := moves.pop()) is not None:
        channel, before = moved
        text += f" after {'?' if before is None else labels(alphabet.channels[channel])[before]}"
    return text
