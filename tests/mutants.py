"""`make mutants`: bugs put in one by one where a wrong number would be believed, and whether a test fails with each.

mutmut makes the mutants. They are tried here, and not by `mutmut run`, for what that costs: the tests of a module are
collected once, what they come by is measured once, and each mutant is a fork of that process in which one function has
another body. Of its tests only those run that come by the changed line, the fastest first, until one fails.
"""

import argparse
import ast
import contextlib
import gc
import os
import random
import resource
import sys
import tempfile
import threading
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from importlib import import_module
from inspect import CO_OPTIMIZED
from multiprocessing import get_context
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest
from mutmut.mutation.file_mutation import create_mutations, deep_replace

ROOT = Path(__file__).parent.parent
FORK = get_context("fork")
PYTEST = ["-p", "no:cacheprovider", "-p", "no:xdist", "--no-summary", "-qs", "--tb=short", "--hypothesis-seed=0"]
TEST_S = 120
"""The longest (real time) that one test may take."""
CPU_FACTOR, CPU_S = 10, 20
"""A mutant is stopped, and so found, after so many times what its tests take, and so many seconds of processor more."""
WALL_S = 3600.0
"""The longest (real time) that the tests as they are, or those of one mutant, may take."""
MEMORY_BYTES = 8 << 30
"""A mutant that fills the memory is stopped, and so found, here."""
LEAST_KILLED = 0.9
"""The share of all mutants that tests must find."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A bug in what runs `now`, as it would run `instead`; its statement's `lines`, and what it `says` otherwise."""

    now: CodeType
    instead: CodeType
    lines: frozenset[int]
    says: tuple[str, ...]


# ---------------------------------------------------------------- the mutants of a module


def functions_in(code: CodeType) -> Iterator[CodeType]:
    """The functions and lambdas of a module that stand in no other, in their order."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from [each] if each.co_flags & CO_OPTIMIZED else functions_in(each)


def content(code: CodeType) -> tuple[Any, ...]:
    """What a function does, wherever it stands."""
    constants = [content(one) if isinstance(one, CodeType) else (type(one), repr(one)) for one in code.co_consts]
    return code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars


def statements(source: str) -> Iterator[range]:
    """The lines of each statement; of one that holds others those before the first of them."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt):
            held = [each.lineno for each in ast.iter_child_nodes(node) if isinstance(each, ast.stmt)]
            yield range(node.lineno, max(min(held, default=(node.end_lineno or node.lineno) + 1), node.lineno + 1))


def differences(before: list[str], after: list[str]) -> tuple[set[int], tuple[str, ...]]:
    """(numbers of the lines of `before` that are others in `after`, what each said and says)."""
    lines: set[int] = set()
    says: list[str] = []
    for kind, low, high, first, last in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        if kind != "equal":
            lines |= set(range(low + 1, max(high, low + 1) + 1))
            says += [*(f"  - {line}" for line in before[low:high]), *(f"  + {line}" for line in after[first:last])]
    return lines, tuple(says)


def mutants_of(path: Path, seed: int) -> Iterator[Mutant | None]:
    """The mutants of a module in an order drawn at random; None for one that changes nothing that a call runs."""
    source = path.read_text(encoding="utf-8")
    module, mutations, *_ = create_mutations(str(path), source)
    random.Random(seed).shuffle(mutations)
    as_is = list(functions_in(compile(source, str(path), "exec", dont_inherit=True)))
    for mutation in mutations:
        text = deep_replace(module, mutation.original_node, mutation.mutated_node).code  # type: ignore[union-attr]
        others = list(functions_in(compile(text, str(path), "exec", dont_inherit=True)))
        changed = [pair for pair in zip(as_is, others, strict=False) if content(pair[0]) != content(pair[1])]
        # One function has changed, or, where a lambda has gone, what runs when the module is imported.
        if len(as_is) != len(others) or len(changed) != 1 or changed[0][0].co_freevars != changed[0][1].co_freevars:
            yield None
            continue
        lines, says = differences(source.splitlines(), text.splitlines())
        whole = lines.union(*(each for each in statements(source) if lines & {*each}))
        yield Mutant(*changed[0], frozenset(whole), says)


def as_loaded(code: CodeType) -> list[FunctionType]:
    """The functions of this process that run it, however they are called or wrapped."""
    gc.unfreeze()  # the tests' own conftest has frozen what it collected, and what is frozen is not found
    where = code.co_filename, code.co_firstlineno
    loaded = [each for each in gc.get_objects() if type(each) is FunctionType]
    near = [each for each in loaded if (each.__code__.co_filename, each.__code__.co_firstlineno) == where]
    return [each for each in near if content(each.__code__) == content(code)]


# ---------------------------------------------------------------- tests


@dataclass(eq=False)
class Coverage:
    """A plugin: the lines of a file that each test comes by, what it takes (s of processor), and what failed.

    The lines of a fixture that several tests share are those of all tests that may have it.
    """

    path: Path
    lines: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    now: set[int] = field(default_factory=set)

    def traced(self, frame: FrameType, event: str, _: Any) -> Any:
        """What the interpreter calls at each call, and in functions of the file at each line."""
        if frame.f_code.co_filename != str(self.path):
            return None
        self.now.add(frame.f_lineno)
        return self.traced

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        outer = self.now
        if fixturedef.scope != "function":
            self.now = self.lines[request.node.nodeid]
        try:
            return (yield)
        finally:
            self.now = outer

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        begun, self.now = time.process_time(), self.lines[item.nodeid]
        threading.settrace(self.traced)
        sys.settrace(self.traced)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
            self.seconds[item.nodeid] = time.process_time() - begun

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failures.append(f"{report.nodeid} fails as it is: {report.longreprtext.splitlines()[-1]}")

    def of(self, item: pytest.Item) -> set[int]:
        """The lines that a test comes by."""
        return set().union(*(self.lines.get(node.nodeid, set()) for node in item.listchain()))


@dataclass(eq=False)
class Failure:
    """A plugin: whether a test failed."""

    seen: bool = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seen = self.seen or report.failed


def run_items(items: Sequence[pytest.Item], plugin: Coverage | Failure) -> None:
    """Run collected tests in this process, until there is a failure."""
    items[0].config.pluginmanager.register(plugin)
    for item, after in zip(items, [*items[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
        if isinstance(plugin, Failure) and plugin.seen:
            break


def processor_s() -> float:
    """Seconds of processor of this process and of all that it has waited for."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    )


def forked(work: Callable[[], Any], cpu_s: float | None = None) -> Any:
    """What `work()` gives in a fork, silent where it has `cpu_s`; None where it was stopped or has ended itself."""
    ours, theirs = FORK.Pipe(duplex=False)

    def child() -> None:
        if cpu_s is not None:
            nothing = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(nothing, stream)
            resource.setrlimit(resource.RLIMIT_CPU, (round(cpu_s) + 1,) * 2)
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES,) * 2)
        theirs.send(work())
        os._exit(0)

    process = FORK.Process(target=child)
    process.start()
    theirs.close()
    answer = None
    with contextlib.suppress(EOFError):
        answer = ours.recv() if cpu_s is None or ours.poll(WALL_S) else None
    if answer is None:
        process.kill()
    process.join()
    return answer


# ---------------------------------------------------------------- the score


@dataclass(frozen=True, slots=True)
class Score:
    """How many mutants of a module there are, were drawn, changed something and were tried, and were found; and the
    `seconds` of processor that it took."""

    module: str
    mutants: int = 0
    drawn: int = 0
    tried: int = 0
    killed: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        return (
            f"{self.killed:4} of {self.tried:4} killed, {self.killed / max(self.tried, 1):6.1%} ({self.drawn:4} of "
            f"{self.mutants:4} drawn), {self.seconds / max(self.tried, 1):5.2f} s of processor each: {self.module}"
        )


@dataclass(eq=False)
class Trials:
    """A plugin that tries the mutants of a module in place of running its tests once."""

    module: str
    sample: int
    seed: int
    score: Score | None = None

    def pytest_configure(self) -> None:
        """No time for the smallest example, and none is remembered."""
        hypothesis = import_module("hypothesis")  # here: its plug-in of pytest would be first
        usual, phase = hypothesis.settings.get_profile("patient"), hypothesis.Phase
        hypothesis.settings.register_profile("mutants", usual, phases=(phase.explicit, phase.generate), database=None)
        hypothesis.settings.load_profile("mutants")

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        path = ROOT / self.module
        import_module(self.module.removesuffix(".py").replace("/", "."))
        coverage: Coverage | None = forked(lambda: self.covered(session.items, path), WALL_S)
        if coverage is None or coverage.failures or session.testsfailed:
            print(*(coverage.failures if coverage else ["its tests cannot be collected, or were stopped"]), sep="\n")
            return True
        by_line: defaultdict[int, set[pytest.Item]] = defaultdict(set)
        for item in session.items:
            for line in coverage.of(item):
                by_line[line].add(item)
        drawn = killed = tried = 0
        for mutant in mutants_of(path, self.seed):
            if tried == self.sample > 0:
                break
            drawn += 1
            functions = [] if mutant is None else as_loaded(mutant.now)
            if mutant is not None and functions:
                reached = set[pytest.Item]().union(*(by_line[line] for line in mutant.lines))
                items = sorted(reached, key=lambda item: (coverage.seconds[item.nodeid], item.nodeid))
                usual_s = sum(coverage.seconds[item.nodeid] for item in items)
                tried, killed = tried + 1, killed + self.found(mutant, functions, items, usual_s)
        mutants = len(create_mutations(str(path), path.read_text(encoding="utf-8"))[1])
        self.score = Score(self.module, mutants, drawn, tried, killed, processor_s())
        return True

    @staticmethod
    def covered(items: Sequence[pytest.Item], path: Path) -> Coverage:
        coverage = Coverage(path)
        run_items(items, coverage)
        return Coverage(path, dict(coverage.lines), coverage.seconds, coverage.failures)

    def found(
        self, mutant: Mutant, functions: Sequence[FunctionType], items: Sequence[pytest.Item], usual_s: float
    ) -> bool:
        """Whether one of the tests fails, or takes far too long; said where none does."""

        def failed() -> bool:
            for function in functions:
                function.__code__ = mutant.instead
            failure = Failure()
            run_items(items, failure)
            return failure.seen

        # None: it was stopped.
        if items and forked(failed, CPU_S + CPU_FACTOR * usual_s) is not False:
            return True
        print(
            f"{self.module}:{min(mutant.lines)} {mutant.now.co_qualname}: "
            f"{f'survived {len(items)} tests' if items else 'no test comes by'}",
            *mutant.says,
            sep="\n",
            flush=True,
        )
        return False


def tried(module: str, tests: Sequence[str], sample: int, seed: int) -> Score | None:
    """The score of one module; None where its tests do not pass as they are."""
    trials = Trials(module, sample, seed)
    with tempfile.TemporaryDirectory() as folder:
        pytest.main([*PYTEST, f"--timeout={TEST_S}", f"--basetemp={folder}/tests", *tests], plugins=[trials])
    return trials.score


def main() -> int:
    """Survivors as they are found, and the score of each module and of all; 1 where fewer than LEAST_KILLED."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants")
    parser.add_argument("only", nargs="*", help="modules, or parts of their names")
    parser.add_argument("--sample", type=int, default=0, help="so many mutants of each module, drawn at random")
    parser.add_argument("--seed", type=int, default=0, help="of the drawing")
    given = parser.parse_args()
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mutmut"]["tests"]
    modules = [module for module in table if not given.only or any(word in module for word in given.only)]
    if not modules:
        parser.error(f"no module of [tool.mutmut.tests] has {' or '.join(given.only)} in its name")
    scores = [forked(lambda at=module: tried(at, table[at], given.sample, given.seed)) for module in modules]
    known = [score for score in scores if score is not None]
    figures = ("mutants", "drawn", "tried", "killed", "seconds")
    every = Score("all", **{name: sum(getattr(score, name) for score in known) for name in figures})
    print(*known, every, sep="\n")
    return int(len(known) < len(modules) or not every.tried or every.killed < LEAST_KILLED * every.tried)


if __name__ == "__main__":
    raise SystemExit(main())
