"""The options of `decanter diagnose` and its help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import historian_machine_option, json_option, map_option, seed_option
from gateway.lab.options import optional_traces_option


class DiagnoseCommand(click.Command):
    """`decanter diagnose [TRACES]...`, with one word of its own in the first place: `decanter diagnose adopt`."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """That of the other command where its word comes first; a trace of that name is given as ./adopt."""
        # No group: its first argument is a trace's path, which a group would take for a command.
        if args[:1] == ["adopt"]:
            from gateway.lab.models.adopt import adopt

            return adopt.make_context(f"{info_name} adopt", args[1:], parent=parent, **extra)
        return super().make_context(info_name, args, parent=parent, **extra)


@click.command(cls=DiagnoseCommand, short_help="Find where model and traces disagree; name what is missing.")
@click.argument("more", nargs=-1, metavar="[TRACES]...")
@click.option("--model", "where", required=True, help="A model directory, a store, a model.json, or DIR/NAME.")
@optional_traces_option
@click.option("--historian", type=click.Path(path_type=Path), help="A gateway's historian instead of --traces.")
@click.option("--since", help="Of the historian: from this time (2026-03-01T06:00) or span (7d, 36h) on [14d].")
@historian_machine_option
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder for the diagnosis.")
@click.option(
    "--effects", "effects", type=click.Path(path_type=Path), help="A TOML file of your own effects, to be named too."
)
@click.option("--max-names", "most", type=click.IntRange(1, 3), default=3, show_default=True, help="Effects at most.")
@click.option("--temperature", help="The signal that a set of artefacts predicts, which does not say it itself.")
@click.option(
    "--propose", "proposes", is_flag=True, help="Save the new model as a candidate in the store that --model is."
)
@click.option("--if-drifting", is_flag=True, help="Only while the drift alarm stands in the historian; for schedules.")
@click.option("--no-report", is_flag=True, help="No page and no pictures: half of the time, for programs.")
@click.option("--experiment", is_flag=True, help="Propose set-points and times that tell rival effects apart.")
@click.option(
    "--experiment-trace",
    "schedule",
    type=click.Path(path_type=Path),
    help="Write the proposed set-points as CSV.",
)
@click.option("--with-experiment", "made", multiple=True, help="Traces of an experiment that was made.")
@seed_option
@json_option
def diagnose(**given: Any) -> None:
    """Diagnose a model on measured traces: find where they disagree, name the missing effect, add it, prove it.

    --out gets diagnosis.json, report.html, pictures, and model/ where an effect was named: an ordinary model that can
    be verified, promoted and diagnosed again. Nothing is named that chance, moved parameters or a rough plant could
    make: the verdict may be "agree", "unexplained" or "too-little-data". The exit code is 0 whatever the verdict.

    What has no name gets laws to look at; `decanter diagnose adopt OUT --name NAME --effects FILE` makes one of them an
    effect of your own, and --effects FILE has such effects named too.

    --propose keeps a new model that verifies as a version of the store, with the experiment that would confirm it;
    nothing is promoted, and a finding that waits already is not proposed again.

    --experiment proposes what to set and for how long, so that effects which these traces cannot tell apart are told
    apart; --experiment-trace writes it as a trace that `decanter emulate` replays. Once it was made, its recording goes
    to --with-experiment.
    """
    from gateway.lab.gap.diagnose import diagnose as work

    work(**given)
