"""Work for several processes, on this computer or on a Dask cluster: who does it, in which order, what a kill costs.

Threads of this process share work whose time goes into large arrays, in which numpy lets go of the interpreter.

What is done depends on the item alone, so that results do not depend on the number of workers or on where they run.
"""

import logging
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from threading import Event
from typing import Any, Protocol, TypeVar
from warnings import catch_warnings, simplefilter

T = TypeVar("T")
R = TypeVar("R")

KILLED_TEXT = "a worker process was killed, most often for want of memory; take fewer --jobs or --runs"
ADDRESS = re.compile(r"(tcp|tls)://(\[[0-9a-fA-F:.%]+\]|[^\s:/\[\]]+):[0-9]{1,5}")
"""What a Dask scheduler's address looks like."""
REACH_TIMEOUT_S = 10.0
"""Seconds in which a cluster must answer and have a worker."""
PATIENCE_TIMEOUTS = 3
"""So many times that long a cluster may be without any worker while work waits for it: a nanny starts a new one."""


class Workers(Protocol):
    """`function` of each item, wherever they are done; `lost` gives what stands for an item that could not be done.

    `lost` gets the item and the reason. `ordered`: results come in the items' order, else each as soon as it is there.
    """

    def __call__(
        self, function: Callable[[T], R], items: Sequence[T], lost: Callable[[T, str], R], *, ordered: bool = True
    ) -> Iterator[R]: ...


def processes(count: int) -> Workers:
    """Work in this process where `count` is 1, else in so many of their own."""

    def run_items(
        function: Callable[[T], R], items: Sequence[T], lost: Callable[[T, str], R], *, ordered: bool = True
    ) -> Iterator[R]:
        if count == 1:
            return map(function, items)
        return parallel(function, items, count, lambda item: lost(item, KILLED_TEXT), ordered=ordered)

    return run_items


def parallel(
    function: Callable[[T], R],
    items: Sequence[T],
    workers: int,
    lost: Callable[[T], R] | None = None,
    *,
    ordered: bool = True,
) -> Iterator[R]:
    """`map` over processes.

    When a process is killed, the first item without a result is done again by itself and the rest goes on after it. If
    it is killed then too, `lost` says what stands in its place; without `lost` that raises ValueError.
    """
    from joblib import Parallel, delayed

    left, alone = dict(enumerate(items)), False
    while left:
        part = dict(list(left.items())[:1]) if alone else dict(left)
        work = Parallel(n_jobs=workers, return_as="generator" if ordered else "generator_unordered")
        try:
            with _close_quietly(work(delayed(_call_item)(function, *each) for each in part.items())) as results:
                for number, result in results:
                    yield result
                    del left[number]
            alone = False
        except BrokenProcessPool:
            if alone:
                if lost is None:
                    raise ValueError(KILLED_TEXT) from None
                (number,) = part
                yield lost(left.pop(number))
            alone = not alone


def _call_item(function: Callable[[T], R], number: int, item: T) -> tuple[int, R]:
    return number, function(item)


@contextmanager
def _close_quietly(results: Generator[R, None, None]) -> Iterator[Generator[R, None, None]]:
    """Where the caller stops early, joblib need not say what was left undone."""
    try:
        yield results
    finally:
        with catch_warnings():
            simplefilter("ignore", UserWarning)
            results.close()


class Threads:
    """`count` threads of a `with threads(...)` block; work that runs long asks now and then whether it is `wanted`."""

    def __init__(self, count: int, pool: ThreadPoolExecutor) -> None:
        self.count = count
        self._pool = pool
        self._over = Event()

    def wanted(self) -> bool:
        """Whether the block still goes on."""
        return not self._over.is_set()

    def submit(self, make: Callable[[int], R], number: int) -> "Future[R]":
        """`make(number)` in the next thread that is free."""
        return self._pool.submit(make, number)

    def end(self) -> None:
        """Begin nothing more; wait for what is under way, which is no longer wanted."""
        self._over.set()
        self._pool.shutdown(cancel_futures=True)


@contextmanager
def threads(count: int) -> Iterator[Threads | None]:
    """So many threads for the block, none of which is left after it, whatever ends it; None where `count` is 1."""
    if count == 1:
        yield None
        return
    made = Threads(count, ThreadPoolExecutor(count, thread_name_prefix="worker"))
    try:
        yield made
    finally:
        made.end()


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """The workers of the Dask scheduler at `address` (tcp://host:port), which must have this package too.

    What a worker cannot do (it was killed, it lacks the package) is lost. Raises ValueError without the extra
    `cluster`, where no scheduler answers within REACH_TIMEOUT_S or it has no worker, and when the scheduler or all
    workers go away for good.
    """
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise ValueError(
            "--cluster needs Dask, which is not installed; install the extra: pip install 'decanter-gateway[cluster]'"
        ) from None
    # The address is looked at before a client is made: one that cannot be made waits 20 s and complains when it is
    # collected.
    if not ADDRESS.fullmatch(address):
        raise ValueError(f"{address!r}: no Dask scheduler answers there, as it is no address; give tcp://HOST:PORT")
    if address.startswith("tls") and distributed.Security().get_connection_args("client").get("ssl_context") is None:
        raise ValueError(
            f"{address}: a TLS connection needs its certificates in Dask's configuration (distributed.comm.tls); "
            "see Dask's documentation on TLS"
        )
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it would say becomes a sentence here
    try:
        client = distributed.Client(address, timeout=REACH_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"{address}: no Dask scheduler answers there ({_reason(error)}); give tcp://HOST:PORT"
        ) from None

    def run_tasks(
        function: Callable[[T], R], items: Sequence[T], lost: Callable[[T, str], R], *, ordered: bool = True
    ) -> Iterator[R]:
        # Not pure: Dask takes a pure call with equal arguments for one that it has done already.
        items_of = {client.submit(function, item, pure=False): item for item in items}
        for future in items_of if ordered else _as_they_end(list(items_of), client):
            error = await_future(future, client, address)
            if error is None:
                yield future.result()
            else:
                reason = f"the cluster could not run it ({type(error).__name__}: {_reason(error)})"
                yield lost(items_of[future], reason)

    with client:
        try:
            client.wait_for_workers(1, timeout=REACH_TIMEOUT_S)
        except TimeoutError:
            raise ValueError(f"{address}: the Dask scheduler has no worker; start one: dask worker {address}") from None
        yield run_tasks


def _as_they_end(futures: Sequence[Any], client: Any) -> Iterator[Any]:
    """The futures, those that are over first; where no worker is left, the next in turn for `await_future` to judge."""
    distributed, left = import_module("distributed"), dict.fromkeys(futures)
    while left:
        over = [future for future in left if future.done()]
        if not over:
            try:
                with client.as_current():
                    distributed.wait(list(left), timeout=REACH_TIMEOUT_S, return_when="FIRST_COMPLETED")
                continue
            except TimeoutError:
                if client.scheduler_info()["workers"]:
                    continue
            except (OSError, CancelledError):
                pass
            over = [next(iter(left))]
        for future in over:
            del left[future]
            yield future


def await_future(future: Any, client: Any, address: str) -> BaseException | None:
    """What went wrong with a future, once it is over. Raises ValueError when there is nobody left to do it."""
    without = 0
    try:
        while without < PATIENCE_TIMEOUTS:
            try:
                error: BaseException | None = future.exception(timeout=REACH_TIMEOUT_S)
            except TimeoutError:
                without = 0 if client.scheduler_info()["workers"] else without + 1
            else:
                if future.cancelled():
                    break
                return error
    except OSError:
        without = 0
    reason = "the cluster has no worker any more" if without else "the connection to the Dask scheduler was lost"
    raise ValueError(f"{address}: {reason}; start it again, and the command")


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
