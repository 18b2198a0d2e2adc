"""The queries of L*_SHA: tests and their error rate, segments and their errors, merges and what they entail."""

import numpy as np
import pytest

from sim.lab.learning.lsha.evidence import PooledEvidence, pool_sums, same_distribution, segment_scatter, weigh_segments
from sim.lab.learning.lsha.identify import identify, rate_alone
from sim.lab.learning.lsha.merging import Partition, learn_partition
from sim.lab.learning.lsha.segments import Motion, TraceSegments, levels, parameters
from sim.lab.learning.lsha.settings import MEMORIES, LshaSettings
from sim.lab.learning.lsha.teacher import renumber_places
from sim.lab.learning.lsha.words import Classes, WordHistory, build_classes, build_words, coordinates, meaning
from sim.lab.learning.runs import free_runs
from sim.sha.automaton import Flow
from sim.sha.events import Alphabet, Bins
from sim.sha.flows import coefficients
from sim.sha.trace import Trace
from tests.learning.lsha_plants import PLANT, by_context, random_traces

N_MIN = 5


def evidence(value: np.ndarray, variance: np.ndarray, scatter: float) -> PooledEvidence:
    w = 1.0 / (scatter**2 + variance)
    rows = (np.ones_like(w), w, w * value, w**2, w**2 * value, w**2 * value**2, w**2 * variance)
    return pool_sums(tuple(float(row.sum()) for row in rows), N_MIN)


def drawn(rng: np.random.Generator, mu: float, count: int, scatter: float) -> tuple[np.ndarray, np.ndarray]:
    """Segments of very different lengths: measurement variances over three decades."""
    variance = 10.0 ** rng.uniform(-2, 1, count)
    return mu + rng.normal(0, np.sqrt(scatter**2 + variance)), variance


@pytest.mark.parametrize(("counts", "assumed"), [((12, 40), 1.0), ((8, 8), 0.3), ((30, 6), 3.0)])
def test_equal_sets_are_told_apart_as_often_as_the_level_says(counts: tuple[int, int], assumed: float) -> None:
    # The scatter that the weights assume may be wrong by a factor of three: the sandwich variance does not mind.
    rng, rejected, trials = np.random.default_rng(1), 0, 1500
    for _ in range(trials):
        one, other = (evidence(*drawn(rng, 3.0, count, 1.0), assumed) for count in counts)
        rejected += same_distribution(one, other, 0.0).p < 0.05
    assert 0.025 < rejected / trials < 0.085


def test_different_sets_are_told_apart_and_a_tolerance_forgives_what_it_says() -> None:
    rng = np.random.default_rng(2)
    one, other = (evidence(*drawn(rng, mu, 60, 0.5), 0.5) for mu in (0.0, 2.0))
    assert same_distribution(one, other, 0.0).p < 1e-6
    assert same_distribution(one, other, 2.2).p > 0.05


def test_measured_badly_is_no_difference() -> None:
    one = evidence(np.zeros(20), np.full(20, 0.01), 0.1)
    poor = evidence(np.full(2, 5.0), np.full(2, 100.0), 0.1)
    sharp = evidence(np.full(2, 5.0), np.full(2, 0.01), 0.1)
    assert same_distribution(one, poor, 0.0).p > 0.3
    assert same_distribution(one, sharp, 0.0).p < 1e-6


def test_evidence_of_two_sets_is_that_of_all_their_segments() -> None:
    rng = np.random.default_rng(3)
    (a, va), (b, vb) = drawn(rng, 1.0, 9, 1.0), drawn(rng, 4.0, 7, 1.0)
    both = evidence(np.append(a, b), np.append(va, vb), 1.0)
    joined = evidence(a, va, 1.0).merge(evidence(b, vb, 1.0))
    assert joined.count == 16
    assert (joined.mean, joined.variance) == pytest.approx((both.mean, both.variance))


def test_the_scatter_between_segments_is_kept_apart_from_their_errors() -> None:
    rng = np.random.default_rng(4)
    variance = 10.0 ** rng.uniform(-1, 1, 400)
    value = 7.0 + rng.normal(0, np.sqrt(0.8**2 + variance))
    rows = np.zeros(400, dtype=np.intp)
    sample = weigh_segments(TraceSegments(value, variance, rows, rows, rows, variance, variance, 0.1), [rows[:1]])
    mean, error, scatter = segment_scatter(sample, np.ones(400, dtype=bool))
    assert mean == pytest.approx(7.0, abs=4 * error)
    assert error < 0.2
    assert scatter == pytest.approx(0.8, abs=0.25)


def star(count: int) -> Classes:
    """A root from which every class is reached by a symbol of its own, and which every class leads back to."""
    keys = tuple(WordHistory((None,)) if n == 0 else WordHistory((n,)) for n in range(count + 1))
    edges = ({f"s{n}": n for n in range(1, count + 1)}, *({} for _ in range(count)))
    return classes_with(keys, edges)


def classes_with(keys: tuple[WordHistory, ...], edges: tuple[dict[str, int], ...]) -> Classes:
    """Classes of one channel, as far apart as their values are."""
    level = Bins("Load", tuple(float(n) for n in range(1, 60)), tuple(f"L_{n}" for n in range(60)))
    return Classes(
        memory="context",
        of_state=np.arange(len(keys)),
        keys=keys,
        edges=edges,
        meaning=meaning(Alphabet((level,))),
        coordinates=coordinates(keys),
    )


def partition(classes: Classes, found: list[PooledEvidence], delta: float = 0.0, alpha: float = 0.05) -> Partition:
    modelled = np.arange(len(classes)) > 0
    nothing = pool_sums((0.0,) * 7, N_MIN)
    return learn_partition(classes, [nothing, *found], modelled, delta=delta, alpha=alpha, n_min=N_MIN)


def test_words_of_one_location_are_kept_apart_at_most_as_often_as_alpha_says() -> None:
    # Family-wise: in how many worlds of 12 equal classes is any of them kept apart? 300 worlds, alpha 0.1.
    rng, apart, worlds = np.random.default_rng(5), 0, 300
    for _ in range(worlds):
        found = [evidence(*drawn(rng, 2.0, int(rng.integers(6, 40)), 1.0), 1.0) for _ in range(12)]
        apart += partition(star(12), found, alpha=0.1).laws > 1
    assert apart / worlds <= 0.1 + 3 * np.sqrt(0.1 * 0.9 / worlds)


def test_words_after_which_a_switch_stands_differently_are_no_location_however_alike_they_are() -> None:
    rng = np.random.default_rng(6)
    table = meaning(PLANT)
    contexts = [(None, None), (0, 0), (0, 1), (1, 0), (1, 1), (1, 2)]
    keys = tuple(WordHistory(context) for context in contexts)
    edges: tuple[dict[str, int], ...] = ({}, {"ON": 3}, {"ON": 4}, {"OFF": 1}, {"OFF": 2}, {})
    classes = Classes("context", np.arange(6), keys, edges, table, coordinates(keys))
    counts = (40, 40, 40, 40, 2)
    result = partition(classes, [evidence(*drawn(rng, 3.0, count, 0.5), 0.5) for count in counts])
    assert result.location.tolist() == [0, 1, 1, 2, 2, 2]
    assert {decision.rival for decision in result.decisions if decision.verdict == "new"} == {None}


def test_words_of_different_locations_are_kept_apart_when_the_evidence_suffices() -> None:
    rng = np.random.default_rng(6)
    means = [0.0, 0.0, 5.0, 5.0, 10.0, 0.0]
    result = partition(star(6), [evidence(*drawn(rng, mu, 60, 0.5), 0.5) for mu in means])
    place = result.location[1:].tolist()
    assert result.laws == 3
    assert len({place[0], place[1], place[5]}) == 1
    assert len({place[2], place[3]}) == 1
    verdicts = [decision.verdict for decision in result.decisions]
    assert verdicts.count("new") == 3
    assert verdicts.count("merged") == 3


def test_a_row_below_n_min_follows_its_neighbour_unless_its_segments_refute_it() -> None:
    rng = np.random.default_rng(7)
    rich = [evidence(*drawn(rng, mu, 60, 0.3), 0.3) for mu in (0.0, 9.0)]
    tight = np.full(2, 0.01)
    fits, refutes = evidence(np.zeros(2), tight, 0.3), evidence(np.full(2, 9.0), tight, 0.3)
    assert partition(star(3), [rich[0], fits, rich[1]]).location.tolist() == [0, 1, 1, 2]
    assert partition(star(3), [rich[0], refutes, rich[1]]).location.tolist() == [0, 1, 2, 2]


def test_a_location_of_few_segments_stays_if_they_speak_against_every_other_one() -> None:
    rng = np.random.default_rng(7)
    rich = [evidence(*drawn(rng, mu, 60, 0.3), 0.3) for mu in (0.0, 9.0)]
    off = evidence(np.array([-20.0, -21.0, -19.0]), np.full(3, 0.01), 0.3)
    result = partition(star(3), [*rich, off])
    assert result.laws == 3
    assert result.location.tolist() == [0, 1, 2, 3]


def test_a_location_of_few_segments_is_dissolved_if_their_scatter_may_be_greater_than_that_of_all() -> None:
    # Three standard errors: p = 0.003 if they scatter as all others do, 0.04 if five segments have to tell that.
    rng = np.random.default_rng(7)
    rich = [evidence(*drawn(rng, mu, 400, 0.3), 0.3) for mu in (0.0, 30.0)]
    error = np.sqrt((0.3**2 + 0.01) / 2)
    doubtful = evidence(np.full(2, -3.0 * error), np.full(2, 0.01), 0.3)
    result = partition(star(3), [*rich, doubtful])
    assert [each.verdict for each in result.decisions if each.row == 3] == ["new", "dissolved"]
    assert result.location.tolist() == [0, 1, 2, 1]


def test_many_segments_of_which_two_carry_the_weight_are_not_told_apart_from_nothing() -> None:
    rng = np.random.default_rng(9)
    running = evidence(*drawn(rng, 0.0, 80, 0.3), 0.3)
    # Two long stays and thirteen that say nothing: the mean is 30 degC off, and its error is half a degree.
    variance = np.array([0.01, 0.01, *np.full(13, 400.0)])
    value = -30.0 + np.array([0.3, -0.3, *rng.normal(0, 20.0, 13)])
    assert same_distribution(running, evidence(value, variance, 0.3), 0.0).p < 1e-3


def test_a_merge_is_refused_when_all_that_it_entails_speaks_against_it_together() -> None:
    """1 and 2 look alike; what follows 1 is in 3, what follows 2 are forty words of one segment, each a little off."""
    symbols = [f"x{n:02d}" for n in range(40)]
    keys = tuple(WordHistory((None,) if n == 0 else (n,)) for n in range(44))
    after_one = dict.fromkeys(symbols, 3)
    after_two = {symbol: 4 + number for number, symbol in enumerate(symbols)}
    edges = ({f"s{n}": n for n in range(1, 44)}, after_one, after_two, *({} for _ in range(41)))
    rng = np.random.default_rng(10)
    found = [evidence(*drawn(rng, mu, count, 0.5), 0.5) for mu, count in ((0.0, 60), (0.0, 60), (20.0, 90))]
    single = [evidence(20.0 + np.array([1.0 + rng.normal(0, 0.5)]), np.array([0.01]), 0.5) for _ in symbols]
    result = partition(classes_with(keys, edges), [*found, *single])
    assert result.location[1] != result.location[2]


def test_a_merge_is_refused_when_a_suffix_speaks_against_it() -> None:
    """1 and 2 look alike, but after `x` they do not; 5 and 6 look alike and agree in what follows."""
    keys = tuple(WordHistory((None,) if n == 0 else (n,)) for n in range(7))
    edges = ({f"s{n}": n for n in range(1, 7)}, {"x": 3}, {"x": 4}, {}, {}, {"x": 3}, {"x": 3})
    classes = classes_with(keys, edges)
    rng = np.random.default_rng(8)
    means = (0.0, 0.0, 20.0, 40.0, 60.0, 60.0)
    result = partition(classes, [evidence(*drawn(rng, mu, 50, 0.3), 0.3) for mu in means])
    place = result.location.tolist()
    assert place[1] != place[2]
    assert place[5] == place[6]
    refused = [one for one in result.decisions if one.suffix]
    assert [one.suffix for one in refused] == [("x",)]


def test_every_segment_is_attached_once_and_to_one_class() -> None:
    traces = random_traces(by_context, 0, count=4)
    words = build_words(traces, PLANT, N_MIN)
    runs = free_runs(traces, words.sha, "T", signals=("Load",), jumps=True)
    found = levels(runs, runs.trace)
    events = [[e.time for e in trace.events] for trace in traces]
    stays = sum(
        len({time for time in times if time < trace.times[-1]}) for times, trace in zip(events, traces, strict=True)
    )
    assert found.value.size == stays
    assert found.readings.sum() == sum(trace.times.size for trace in traces)
    sample = weigh_segments(found, [build_classes(words, "previous").of_state])
    for memory in MEMORIES:
        classes = build_classes(words, memory)
        pooled = sample.pool_classes(classes.of_state, len(classes), N_MIN)
        assert sum(one.count for one in pooled) == stays


def test_a_segment_s_parameter_and_its_error_are_right() -> None:
    traces = random_traces(by_context, 1, count=20, scatter=0.0, tau=200.0)
    words = build_words(traces, PLANT, N_MIN)
    runs = free_runs(traces, words.sha, "T", signals=("Load",), jumps=True)
    decay, pull, _ = coefficients(Flow("exponential", {"k": 1 / 200.0, "noise": 0.0}), runs.age, runs.dt)
    found = parameters(runs, runs.trace, Motion(decay, pull, np.zeros(len(runs))), 1600.0)
    truth = np.array([by_context(s.context[0] or 0, s.context[1] or 0, 0) for s in words.states])[found.place]
    z = (found.value - truth) / np.sqrt(found.variance)
    assert found.noise == pytest.approx(0.1, rel=0.05)
    assert z.std() == pytest.approx(1.0, abs=0.1)
    assert found.variance.max() > 20 * found.variance.min()


def test_single_segments_tell_the_rate_whatever_they_have_in_common() -> None:
    # The scatter of 15 degC from stay to stay hides which of them belong together; the shape of each stay is left.
    traces = random_traces(by_context, 9, count=12, scatter=15.0, tau=150.0)
    words = build_words(traces, PLANT, N_MIN)
    runs = free_runs(traces, words.sha, "T", signals=("Load",), jumps=True)
    assert 1.0 / rate_alone(runs, "exponential") == pytest.approx(150.0, rel=0.05)


def test_every_word_of_the_traces_is_told_apart_however_many_events_there_are() -> None:
    traces = random_traces(by_context, 10, count=4)
    few, many = build_words(traces, PLANT, 2), build_words(traces * 40, PLANT, 200)
    assert many.events > 3000
    for words in (few, many):
        assert len(build_classes(words, "word")) == 1 + len(
            {e[: n + 1] for e in spelled_out(traces) for n in range(len(e))}
        )
    longest = max(range(len(few.tree)), key=lambda node: len(few.node_word(node + 1)))
    assert few.node_word(longest + 1) in spelled_out(traces)


def spelled_out(traces: list[Trace]) -> list[tuple[str, ...]]:
    return [tuple(event.symbol for event in trace.events) for trace in traces]


def test_a_location_with_another_flow_is_identified_and_the_others_keep_the_default() -> None:
    traces = random_traces(by_context, 2, count=10, tau=60.0, scatter=0.5)
    words = build_words(traces, PLANT, N_MIN)
    classes = build_classes(words, "context")
    runs = renumber_places(free_runs(traces, words.sha, "T", signals=("Load",), jumps=True), classes.of_state)
    linear = Flow("linear", {"noise": 0.0})
    rates = {"exponential": Flow("exponential", {"k": 1 / 60.0, "noise": 0.0}), "linear": linear}
    motions = {
        kind: Motion(*coefficients(flow, runs.age, runs.dt)[:2], np.zeros(len(runs))) for kind, flow in rates.items()
    }
    wrong = identify(
        runs,
        len(classes),
        default="linear",
        motion=motions["linear"],
        alternatives={"exponential": rates["exponential"]},
        alpha=0.05,
        n_min=5,
    )
    right = identify(
        runs,
        len(classes),
        default="exponential",
        motion=motions["exponential"],
        alternatives={"linear": linear},
        alpha=0.05,
        n_min=5,
    )
    assert {one.kind for one in wrong if not one.kept} == {"exponential"}
    assert sum(not one.kept for one in wrong) > 0.5 * len(wrong)
    assert all(one.kept for one in right)


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ({"delta": -0.1}, "delta is -0.1; it must be 0 or more"),
        ({"delta": float("nan")}, "delta is nan"),
        ({"memory": "all"}, "the memory 'all' is unknown; known are context, direction, previous, word"),
        ({"default_flow": "cubic"}, "the default flow 'cubic' is unknown; known are constant, linear"),
        ({"n_min": 1}, "n_min is 1; two segments are the least"),
        ({"alpha": 1.0}, "alpha is 1.0; it must lie between 0 and 1"),
        ({"split": 1}, "split is 1; the traces must be split into two parts at least"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValueError, match="^" + sentence.replace(".", r"\.")):
        LshaSettings(**setting)
