"""The benchmark of `decanter diagnose --experiment`: near-twins, the experiment made, and diagnosed again.

\b
python -m benchmarks.discrepancy.experiment --set fresh --count 6 --out DIR --cases
"""

from pathlib import Path

import click

from benchmarks.discrepancy.experiment.again import close_circle
from benchmarks.discrepancy.experiment.cases import KINDS, draw, scale, specs, write_days
from benchmarks.discrepancy.experiment.figures import tables
from benchmarks.discrepancy.recorder.cases import SETS


@click.command(help=__doc__)
@click.option("--set", "set_", type=click.Choice(list(SETS)), default="fresh", show_default=True, help="Which seeds.")
@click.option("--kind", "kinds", type=click.Choice(list(KINDS)), multiple=True, help="May be given again.  [all]")
@click.option("--count", type=click.IntRange(1), default=6, show_default=True, help="Cases of each kind.")
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The first one's number.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Where the cases go.")
@click.option("--plc", is_flag=True, help="Set-points and recording go over the software PLC, by Modbus TCP.")
@click.option("--cases", "every", is_flag=True, help="Every case in a line too.")
def main(set_: str, kinds: tuple[str, ...], count: int, first: int, out: Path, plc: bool, every: bool) -> None:
    """Make cases, diagnose, make the experiment that is proposed, diagnose again, and print what became of it."""
    ways = []
    for one in kinds or KINDS:
        drawn = scale([draw(spec, out) for spec in specs(set_, one, range(first, first + count))])
        write_days([case for case, _ in drawn], out)
        for case, ratio in drawn:
            way = close_circle(case, ratio, out, plc=plc)
            ways.append(way)
            click.echo(
                f"{one}, {way.acts}: {way.first.diagnosis.get('verdict')}, then {way.fate or 'nothing'}", err=True
            )
    click.echo(tables(ways, every=every))


if __name__ == "__main__":
    main()
