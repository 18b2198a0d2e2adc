"""Run `decanter` with the stacks of its main thread sampled: `python benchmarks/sampled.py SOURCE OUT ARGUMENT...`.

SOURCE is the checkout whose code runs. Sampling begins with SIGUSR1 and ends with the program; OUT then has a line for
each stack, its frames from the outermost on and the microseconds of the main thread's processor time that fell on it,
and one for each other thread: its name between angle brackets and its microseconds.
"""

import signal
import sys
import threading
import time
from collections import Counter
from importlib import import_module
from pathlib import Path
from types import FrameType

EVERY_S = 0.001


def main() -> None:
    source, out = sys.argv[1:3]
    # Not this script's folder, whose modules have the names of libraries.
    sys.path[0] = source
    sys.argv = ["decanter", *sys.argv[3:]]
    stacks: Counter[tuple[str, ...]] = Counter()
    before = 0.0
    clocks: dict[tuple[int, str], float] = {}

    def count_others() -> None:
        # Threads are told apart by their names, which the system does not know: two of one name are one row.
        for thread in threading.enumerate():
            if thread.ident is not None and thread is not threading.main_thread():
                key, used = (thread.ident, thread.name), time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
                stacks[(f"<{thread.name}>",)] += round(1e6 * (used - clocks.get(key, used)))
                clocks[key] = used

    def sample(_number: int, frame: FrameType | None) -> None:
        # The timer runs on the time of all threads: each sample counts for what the main thread has used since.
        nonlocal before
        now = time.thread_time()
        stack = []
        while frame is not None:
            code = frame.f_code
            module = frame.f_globals.get("__name__", "?")
            stack.append(f"{module}:{code.co_qualname.replace('<locals>.', '')}")
            frame = frame.f_back
        stacks[tuple(reversed(stack))] += round(1e6 * (now - before))
        count_others()
        before = time.thread_time()

    def begin(_number: int, _frame: FrameType | None) -> None:
        nonlocal before
        count_others()
        before = time.thread_time()
        signal.setitimer(signal.ITIMER_PROF, EVERY_S, EVERY_S)

    signal.signal(signal.SIGPROF, sample)
    signal.signal(signal.SIGUSR1, begin)
    try:
        import_module("gateway.cli.main").main()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        lines = (f"{';'.join(stack)} {weight}\n" for stack, weight in stacks.items())
        Path(out).write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
