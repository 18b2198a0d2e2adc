"""Kills at drawn moments: what the records lose, which blocks have no row, and whether an old number was ever usable.

Gateway and software PLC are killed with SIGKILL and started again, in turns of fifty, the gateway armed in every other
turn. A number is old if the PLC called a block usable whose temperature its bearing did not have at any moment since
the age that the block gives for it; the replayed temperatures move all the time.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import click

from benchmarks.figures import Figure, give
from benchmarks.processes import BenchmarkError
from gateway.console import progress
from gateway.store.audit import verify
from tests.integration.test_kills import Aftermath, many_kills
from tests.rig.blocks import old_numbers, unaccounted

TURN = 50


@dataclass(frozen=True, slots=True)
class Toll:
    """What all turns have cost together."""

    kills: int = 0
    blocks: int = 0
    lost: int = 0
    ended: int = 0
    unaccounted: int = 0
    broken: int = 0
    old: int = 0

    def with_turn(self, aftermath: Aftermath) -> "Toll":
        """The toll after one more turn."""
        audit = aftermath.rig.records / "audit.sqlite"
        return replace(
            self,
            kills=self.kills + aftermath.kills.total(),
            blocks=self.blocks + len(aftermath.recording.blocks),
            lost=self.lost + sum(sum(each.values()) for each in aftermath.losses),
            ended=self.ended + len(aftermath.ended_by_itself),
            unaccounted=self.unaccounted + unaccounted(aftermath.recording, audit),
            broken=self.broken + bool(verify(audit).problem),
            old=self.old + old_numbers(aftermath.recording),
        )


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Ten kills, armed.")
@click.option("--count", default=1000, show_default=True, type=click.IntRange(1), help="Kills.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of moments and victims.")
def main(as_json: bool, quick: bool, count: int, seed: int) -> None:
    toll, left = Toll(), 10 if quick else count
    with progress("kills") as report:
        for turn in range(-(-left // TURN)):
            with tempfile.TemporaryDirectory(prefix="decanter-kills-") as name:
                mode = "shadow" if turn % 2 else "armed"
                toll = toll.with_turn(many_kills(Path(name), min(TURN, left - TURN * turn), seed + turn, mode))
            report("killing", toll.kills / left)
    if toll.ended:
        raise BenchmarkError(f"{toll.ended} processes had ended before they were killed")
    other = ("kills", float(toll.kills))
    figures = [
        Figure("committed rows lost", float(toll.lost), "", *other),
        Figure("blocks without a row in the audit log", float(toll.unaccounted), "", "blocks", float(toll.blocks)),
        Figure("audit chains that do not verify", float(toll.broken), "", *other),
        Figure("usable blocks with an old number", float(toll.old), "", "blocks", float(toll.blocks)),
    ]
    give("kills", figures, as_json=as_json)


if __name__ == "__main__":
    main()
