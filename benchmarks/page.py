"""What the page costs: first paint, an update's way to the screen, twenty clients, and what a scan notices of them.

    python -m benchmarks.page [--seconds 20] [--clients 20] [--trends | --tab] [--json]

One gateway with a model on a device in memory, one scan a second, as a process of its own; the browser is headless
Chromium. An update's latency is from the reading's own time to the frame in which the browser shows it. What the
clients cost is the gateway's processor time with them less that without. What a scan notices is how far its begin is
off the period, and how long it takes, without clients and with them. What a tab costs is the processor time of the
browser's process that draws it. A day in one tab is what its script holds and how many nodes there are after an hour
and after a day of pictures ten seconds apart, handed to it as fast as it draws them. There the browser does without its
compilers: machine code, which it makes of whatever ran often and throws away again, would be taken for what is kept.
"""

import asyncio
import http.client
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from math import sin
from pathlib import Path
from typing import Any

import click

from benchmarks.figures import Figure, give
from drivers.tag import Tag
from gateway.machine.reading import plant_clock
from gateway.outside.web.reader import HistorianReader
from gateway.plant.app import SWITCH_SECONDS, run
from gateway.store import percentile, reading, stored_rows
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, Bench, config_in, logged, one_machine, two_modes

SHOWN = """
() => {
  window.late = [];
  const big = document.querySelector('.row .big');
  new MutationObserver(() => requestAnimationFrame(() => {
    const shown = Number(big.textContent.replace(/[^0-9.]/g, ''));
    window.late.push([shown, Date.now() / 1000]);
  })).observe(big, { characterData: true, childList: true, subtree: true });
}
"""


async def gateway(folder: Path) -> None:
    """The gateway, until SIGTERM; what its device reads changes with each second."""
    text = "[page]\nenabled = true\nport = 0\n[forecast]\nhorizons = [60.0, 300.0, 900.0]\n"
    config = config_in(folder, text, model=two_modes())
    clock, stop = plant_clock(1.0), asyncio.Event()
    bench = Bench(config, clock)  # type: ignore[arg-type]
    bench.plan = {}
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    for name, value in ((RUNNING, True), (CURRENT, 150.0), (TEMPERATURE, 40.0)):
        bench.soft.put(name, value)

    async def vary() -> None:
        step = 0
        while True:
            # A tenth of a degree tells one reading from the next on the screen.
            bench.soft.put(TEMPERATURE, 40.0 + (step % 50) / 10.0)
            step += 1
            await asyncio.sleep(1.0)

    varying = asyncio.create_task(vary())
    await run(config, clock=clock, driver=bench, stop=stop)
    varying.cancel()


@contextmanager
def running(folder: Path) -> Iterator[tuple[int, int]]:
    """The process and the port of a gateway with its page."""
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.page", "--serve", str(folder)])
    try:
        for _ in range(400):
            lines = logged(folder) if (folder / "gateway.jsonl").exists() else []
            if found := [line["address"] for line in lines if line["event"] == "the page is served"]:
                break
            time.sleep(0.05)
        yield process.pid, int(found[0].rpartition(":")[2])
    finally:
        process.terminate()
        process.wait(20.0)


def processor(pid: int) -> float:
    """Processor seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def follow(port: int, stop: threading.Event, seen: dict[float, float]) -> None:
    """One client of the stream; notes when each picture was taken, and how late it comes after that (s)."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    connection.request("GET", "/api/live")
    stream = connection.getresponse()
    while not stop.is_set():
        line = stream.readline()
        if line.startswith(b"data: "):
            taken = re.search(rb'"taken": ([0-9.]+)', line)
            if taken:
                seen[float(taken[1])] = time.time() - float(taken[1])
    connection.close()


def delays(folder: Path, start: float, end: float) -> list[float]:
    """How far each space between two scans is from the period (s), between two times, and how long a scan took."""
    with reading(folder / "history.sqlite") as connection:
        rows = stored_rows(connection, "scans", ("time", "duration"), start, end)
    return [abs(after[0] - before[0] - 1.0) + after[1] for before, after in pairwise(rows)]


def browser(port: int, seconds: float) -> dict[str, Any]:
    """First paint and updates, by headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        chromium = started.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox", "--disable-gpu"])
        paints = []
        for _ in range(5):
            page = chromium.new_page()
            page.goto(f"http://127.0.0.1:{port}/")
            page.wait_for_selector(".row .sentence")
            paints.append(
                page.evaluate(
                    "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? performance.now()"
                )
            )
            page.close()
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector(".row .sentence")
        page.evaluate(SHOWN)
        page.wait_for_timeout(1000.0 * seconds)
        shown = page.evaluate("window.late")
        heap = page.evaluate("performance.memory?.usedJSHeapSize ?? 0")
        chromium.close()
    return {"first_paint_ms": paints, "shown": shown, "heap_mb": heap / 1e6}


NO_COMPILERS = "--js-flags=--no-opt,--no-maglev,--no-sparkplug"
DRAWN_VIEWS = ("plant", "wall", "machine/decanter")
HOLD_STREAM = """
const Stream = window.EventSource;
window.EventSource = class extends Stream { constructor(...given) { super(...given); window.held = this; } };
"""
A_DAY = """async ([from, until, step]) => {
  const { machines } = window.told ??= (held.close(), await (await fetch("/api/plant")).json());
  window.requestAnimationFrame = (work) => (work(performance.now()), 0);
  for (let second = from; second < until; second += step) {
    const at = {}, wave = Math.sin(second / 600);
    for (const [name, machine] of Object.entries(machines)) {
      const { status } = machine, time = status.time + second, value = 45 + 3 * wave;
      const read = (own) => ({ ...own, time, value: typeof own.value === "number" ? value : own.value });
      const values = Object.fromEntries(Object.entries(status.values).map(([tag, own]) => [tag, read(own)]));
      const forecast = status.forecast && { ...status.forecast, time };
      const rows = machine.temperatures.map((row) => ({ ...row, value, sentence: `${row.label} ${value}` }));
      const shown = { ...status, time, values, forecast };
      at[name] = { ...machine, taken: Date.now() / 1000, temperatures: rows, status: shown };
    }
    held.onmessage({ data: JSON.stringify({ order: Object.keys(at), machines: at }) });
    if (second % (20 * step) === 0) await new Promise((done) => setTimeout(done));
  }
}"""
"""Pictures from one second after the newest to another, each drawn as it comes; the stream itself is shut."""


def measure_tab(seconds: float) -> list[Figure]:
    """What one tab costs at a picture a second, by view, and what it holds after a day."""
    from playwright.sync_api import sync_playwright

    figures = []
    with tempfile.TemporaryDirectory() as name, running(Path(name)) as (_, port), sync_playwright() as started:
        with opened(started) as (whole, page):
            for view in DRAWN_VIEWS:
                page.goto(f"http://127.0.0.1:{port}/#/{view}")
                page.wait_for_timeout(5000.0)
                before = drawing(whole)
                page.wait_for_timeout(1000.0 * seconds)
                cost = 100.0 * (drawing(whole) - before) / seconds
                figures.append(Figure(f"one tab, {view}", cost, "% of a core", "goal", 2.0))
        with opened(started, NO_COMPILERS) as (_, page):
            page.add_init_script(HOLD_STREAM)
            for view in DRAWN_VIEWS:
                page.goto("about:blank")
                page.goto(f"http://127.0.0.1:{port}/#/{view}")
                page.wait_for_timeout(2000.0)
                page.evaluate(A_DAY, [0, 3600, 10])
                (heap, nodes), _ = held(page), page.evaluate(A_DAY, [3600, 86_400, 10])
                heap_after, nodes_after = held(page)
                figures += [
                    Figure(f"script's memory after a day, {view}", heap_after, "MB", "after an hour", heap),
                    Figure(f"nodes after a day, {view}", nodes_after, "", "after an hour", nodes),
                ]
    return figures


@contextmanager
def opened(started: Any, *flags: str) -> Iterator[tuple[Any, Any]]:
    """A browser's own CDP session and a page of it; `started` is Playwright."""
    arguments = ["--no-sandbox", "--disable-gpu", *flags]
    chromium = started.chromium.launch(executable_path="/usr/bin/chromium", args=arguments)
    page = chromium.new_page()
    page.set_default_timeout(600_000.0)
    yield chromium.new_browser_cdp_session(), page
    chromium.close()


def drawing(whole: Any) -> float:
    """Processor seconds so far of the processes of a browser that draw."""
    told = whole.send("SystemInfo.getProcessInfo")["processInfo"]
    return sum(float(one["cpuTime"]) for one in told if one["type"] == "renderer")


def held(page: Any) -> tuple[float, int]:
    """What a page's script holds (MB), and how many nodes there are."""
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    nodes = session.send("Memory.getDOMCounters")["nodes"]
    return session.send("Runtime.getHeapUsage")["usedSize"] / 1e6, nodes


SPANS = {"1 min": 60, "1 h": 3600, "1 d": 86_400, "7 d": 7 * 86_400, "90 d": 90 * 86_400}


def time_trends(days: int, period: int, labels: Sequence[str]) -> dict[str, float]:
    """Seconds until a trend is there, by what it spans, from days of a reading each `period` s (median of five)."""
    with tempfile.TemporaryDirectory() as name:
        path, begin, count = Path(name) / "history.sqlite", 1_700_000_000.0, days * 86_400
        tag = Tag("T", "holding:0", unit="degC")
        store, view = one_machine(path, [tag])
        for first in range(0, count, 20_000 * period):
            times = [begin + second for second in range(first, min(first + 20_000 * period, count), period)]
            view.put("scans", [(time_, 0.01, 0) for time_ in times])
            view.put("samples", [("T", time_, 50.0 + 10.0 * sin(time_ / 3000.0), 0, time_) for time_ in times])
            store.flush(60.0)
        store.close()

        async def ask() -> dict[str, float]:
            reader, found = HistorianReader(path, 15.0 * period), {}
            end = begin + count
            await reader.trend("decanter", "T", end - 60.0, end)  # the process begins
            for label in labels:
                took = []
                for place in range(5):
                    begun = time.perf_counter()
                    await reader.trend("decanter", "T", end - SPANS[label] - place, end - place)
                    took.append(time.perf_counter() - begun)
                found[label] = round(percentile(took, 0.5), 3)
            await reader.close()
            return found

        return asyncio.run(ask())


def measure_trends() -> list[Figure]:
    """Trends of a week by the second and of ninety days by the minute, of one tag."""
    week = [
        Figure(f"trend of {span}", took, "s")
        for span, took in time_trends(7, 1, ("7 d", "1 d", "1 h", "1 min")).items()
    ]
    long = [
        Figure(f"trend of {span}, read each minute", took, "s", "goal", 0.2)
        for span, took in time_trends(90, 60, ("90 d", "7 d", "1 d")).items()
    ]
    return week + long


def measure(seconds: float, clients: int) -> list[Figure]:
    """All figures of one gateway and its browsers, each against its goal where there is one."""
    with tempfile.TemporaryDirectory() as name, running(Path(name)) as (pid, port):
        folder = Path(name)
        time.sleep(5.0)
        begun, before = time.time(), processor(pid)
        time.sleep(seconds)
        alone, alone_end = processor(pid) - before, time.time()
        stop, seen_by = threading.Event(), [dict[float, float]() for _ in range(clients)]
        threads = [threading.Thread(target=follow, args=(port, stop, own), daemon=True) for own in seen_by]
        for thread in threads:
            thread.start()
        time.sleep(2.0)
        with_begun, before = time.time(), processor(pid)
        time.sleep(seconds)
        crowd, with_end = processor(pid) - before, time.time()
        stop.set()
        for thread in threads:
            thread.join(3.0)
        late = [delay for own in seen_by for delay in own.values()]
        # What was taken while all of them followed; the newest may be on its way to some.
        told = {taken for own in seen_by for taken in own if with_begun < taken < with_end - 1.0}
        missed = sum(len(told - set(own)) for own in seen_by)
        seen = browser(port, seconds)
        time.sleep(2.0)
        with reading(folder / "history.sqlite") as connection:
            rows = stored_rows(connection, "predictions", ("time", "measured"))
        by_value = {round(measured, 1): at for at, measured in rows if measured is not None and at > with_end}
        screen = [at - by_value[value] for value, at in seen["shown"] if value in by_value and at >= by_value[value]]
        alone_ms = 1000 * percentile(delays(folder, begun, alone_end), 0.99)
        with_ms = 1000 * percentile(delays(folder, with_begun, with_end), 0.99)
        return [
            Figure("first paint, slowest of several", max(seen["first_paint_ms"]), "ms", "goal", 1000.0),
            *(
                Figure(f"from a reading to the screen, {name}", 1000 * percentile(screen, share), "ms", "goal", 300.0)
                for name, share in (("p50", 0.5), ("p99", 0.99))
            ),
            *(
                Figure(f"from the gateway to {clients} clients, {name}", 1000 * percentile(late, share), "ms")
                for name, share in (("p50", 0.5), ("p99", 0.99))
            ),
            Figure(f"{clients} clients", 100 * (crowd - alone) / seconds, "% of a core", "goal", 15.0),
            Figure("a picture for a client", 1e6 * (crowd - alone) / max(len(told) * clients, 1), "us of a core"),
            Figure(f"pictures that one of {clients} clients missed", missed, "", "of", len(told) * clients),
            Figure(f"a scan's delay with {clients} clients, p99", with_ms, "ms", "without a client", alone_ms),
            Figure("memory of the page's script", seen["heap_mb"], "MB"),
        ]


@click.command()
@click.option("--seconds", type=click.FloatRange(5.0), default=20.0, show_default=True, help="Of each stretch.")
@click.option("--clients", type=click.IntRange(1, 60), default=20, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
@click.option("--trends", is_flag=True, help="Of trends alone.")
@click.option("--tab", is_flag=True, help="Of one tab alone, and of a day in it.")
@click.option("--serve", type=click.Path(path_type=Path, file_okay=False), hidden=True)
def main(seconds: float, clients: int, trends: bool, tab: bool, as_json: bool, serve: Path | None) -> None:
    """What the page costs, and what a scan notices of it."""
    if serve is not None:
        sys.setswitchinterval(SWITCH_SECONDS)
        asyncio.run(gateway(serve))
        return
    if tab:
        give("page", measure_tab(seconds), as_json=as_json)
        return
    figures = [] if trends else measure(seconds, clients)
    give("page", figures + measure_trends(), as_json=as_json)


if __name__ == "__main__":
    main()
