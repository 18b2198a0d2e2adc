"""`decanter demo`: the main job end to end on this machine."""

from collections.abc import Sequence
from pathlib import Path

import click

from gateway.console import finite, map_option, seed_option
from gateway.demo.links import DEFAULT_LINK, LINKS


@click.command(short_help="Run the main job on this computer, with a picture.")
@click.option(
    "--trace",
    "paths",
    multiple=True,
    help="A recorded trace instead of the embedded synthetic ones; a file, folder or glob.",
)
@map_option
@click.option(
    "--limit",
    type=click.FloatRange(-300, 3000),
    callback=finite,
    help="Alarm limit in °C.  [default: 80, or above what was learned from]",
)
@click.option(
    "--seconds",
    type=click.FloatRange(5, 3600),
    callback=finite,
    help="Real time for the replay, at most 100 times faster than it was; a longer trace is cut.  "
    "[default: the whole trace, in 30 s or as long as it takes]",
)
@seed_option
@click.option(
    "--link", type=click.Choice(tuple(LINKS)), default=DEFAULT_LINK, show_default=True, help="The way to the PLC."
)
@click.option("--discrepancy", is_flag=True, help="The other demonstration: a hidden effect is found, named and added.")
@click.option("--out", type=click.Path(path_type=Path), help="[default: out/demo, out/demo-discrepancy]")
@click.option("--json", "as_json", is_flag=True, help="Only one JSON object at the end.")
def demo(
    paths: Sequence[str],
    map_name: str,
    limit: float | None,
    seconds: float | None,
    seed: int,
    link: str,
    discrepancy: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Run the main job end to end: PLC over Modbus or another link, events, prediction, registers written back.

    A software PLC and the gateway are two processes over a real link. The PLC runs a simulated decanter whose gearbox
    bearing goes to 80 °C on its own: the forecast warns before, the PLC feeds less and the temperature turns; the same
    day without the gateway is shown beside it. The feed bearing has a model, a block and alarms of its own. The models
    are learned before, from three other days. On the way the PLC refuses its connections for two seconds. With --trace
    a trace of yours is replayed: the models are learned from its first 60 %, and predict the rest.

    With --discrepancy: a model is learned, then something in its (simulated) plant changes that it knows nothing of.
    Where they disagree is found, the missing effect named and added, and the error on new days shown before and after.
    """
    if discrepancy:
        if paths or limit is not None or seconds is not None or link != DEFAULT_LINK:
            raise click.UsageError(
                "--discrepancy simulates its own plant; leave --trace, --limit, --seconds, --link out"
            )
        # What `decanter diagnose` needs takes longer to load than all the rest: the main job shall not wait for it.
        from gateway.demo.gap import demonstrate

        demonstrate(seed, out or Path("out/demo-discrepancy"), as_json=as_json)
        return
    from gateway.demo import main_job  # the help shall wait for neither

    main_job.demonstrate(
        paths,
        map_name,
        limit=limit,
        seconds=seconds,
        seed=seed,
        link=link,
        out=out or Path("out/demo"),
        as_json=as_json,
    )
