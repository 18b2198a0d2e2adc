"""Disarming at thousands of random moments, on every link: what leaves after the reply, and what stands usable then.

`python -m benchmarks.disarms [--moments N] [--seed N]` prints one row a link; exit code 1 if a usable block left after
a disarming. Half of the disarmings meet a second client's in the same moment. The short form runs in the tests.
"""

import asyncio
import random
import tempfile
from pathlib import Path

import click

from tests.drivers.test_contract import BENCHES
from tests.rig.disarms import Disarms, disarmed_at_random

SPAN_S = 0.02
"""The longest time from arming to disarming: a few blocks."""


async def _on(link: str, seed: int, moments: int) -> Disarms:
    with tempfile.TemporaryDirectory() as folder:
        bench = BENCHES[link]()
        try:
            return await disarmed_at_random(await anext(bench), Path(folder), random.Random(seed), moments, SPAN_S)
        finally:
            await anext(bench, None)


@click.command()
@click.option("--moments", default=1430, show_default=True, help="Disarmings on each link; seven links make 10,000.")
@click.option("--seed", default=14, show_default=True)
def main(moments: int, seed: int) -> None:
    """Disarm at random moments on every link; exit code 1 if anything usable left after the reply."""
    click.echo("| link | disarmings | with usable blocks before | usable block after the reply | left usable |")
    click.echo("|---|---|---|---|---|")
    wrong = 0
    for link in sorted(BENCHES):
        seen = asyncio.run(_on(link, seed, moments))
        wrong += seen.overtaken + seen.left_usable
        click.echo(f"| {link} | {seen.moments} | {seen.usable_before} | {seen.overtaken} | {seen.left_usable} |")
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
