"""`decanter plc replay`: what the gateway does with a recording."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform_at
from gateway.console.output import progress, sentences, table

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@link_options
def replay(given: Given, recording: Path) -> None:
    """Send a RECORDING through the gateway as if it came from the PLC: events, predictions, alarms, blocks.

    It is a CSV (soak --record, or a trace) or a gateway's historian. Needs --config; the device is not asked, nothing
    is written, and the gateway's own records stay as they are.
    """
    with sentences():
        from gateway.commission.records import check_writable
        from gateway.commission.target import Target
        from gateway.settings.config import load_config

        if given.plant is None:
            raise ValueError("which gateway? Give its plant file (--config FILE)")
        config = load_config(given.plant)
        check_writable(given.records)
        target = Target("", "soft", {}, config.map, config, (given.plant, config.map.path, recording))

    async def work(site: "Site") -> "Outcome":
        from gateway.commission.recording import read_recording
        from gateway.commission.replaying import replay as work

        with progress("replay") as report:
            return await work(site, config, read_recording(recording), report)

    perform_at(target, given, "replay", {"recording": str(recording)}, work, _show)


def _show(data: Mapping[str, Any]) -> None:
    rows = [
        ("recording", f"{data['rows']} rows over {data['seconds']:.6g} s, {data['scans']} scans"),
        ("tags that it lacks", ", ".join(data["missing_tags"]) or "none"),
        ("tags not good", ", ".join(f"{name} {count} x" for name, count in data["not_good"].items()) or "none"),
        ("events", str(data["events"])),
        ("model", data["model"] or "none: nothing is predicted"),
        ("locations (scans)", _counts(data["locations"])),
        ("confidence (scans)", _counts(data["zones"])),
        ("one step ahead", _error(data["one_step"], data["band90"])),
        ("free run", _error(data["free_run"], None)),
        ("blocks", f"{data['blocks']} computed, {data['blocks_valid']} of them valid, none written"),
    ]
    table("what the gateway made of it", ("what", "found"), rows)
    ahead = [(one["horizon"], one["mae"], one["persistence_mae"], one["count"]) for one in data["forecasts"]]
    if ahead:
        table("forecasts", ("s ahead", "median off (degC)", "persistence off (degC)", "matured"), ahead)
    alarms = [(_at(one["time"]), one["alarm"], one["state"]) for one in data["alarms"]]
    if alarms:
        table(f"{len(alarms)} changes of alarms, the first 20", ("time", "alarm", "state"), alarms[:20])


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in list(counts.items())[:6]) or "none"


def _error(error: Mapping[str, Any], band: float | None) -> str:
    if not error["count"]:
        return "nothing to compare"
    covered = f", {band:.0%} within the 90 % band" if band is not None else ""
    return f"{error['mae']:.3g} degC off on average, root mean square {error['rmse']:.3g} ({error['count']}){covered}"


def _at(moment: float) -> str:
    return datetime.fromtimestamp(moment, UTC).strftime("%Y-%m-%d %H:%M:%S")
