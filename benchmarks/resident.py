"""Does the gateway's memory level off? Its resident size over hours of plant time, and how fast it grows at the end.

The gateway runs as `decanter run` starts it, armed, with model, historian, log and forecasts, against the software PLC
whose trace goes on; a plant second takes less than a second of both clocks. The resident size is VmRSS of
/proc/PID/status, which a forecast or a batch that is packed raises for some seconds: given are the medians of the
twentieth of the time about each moment. The growth is the slope of least squares over the last half, with two standard
errors of it, from the medians of ten parts, which are more nearly independent than the samples.
"""

import tempfile
import time
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from benchmarks.processes import gateway, growth, learned_model, resident_kilobytes, software_plc, until_usable

SAMPLE_SECONDS = 0.5


def measure(hours: float, speed: float, period: float) -> list[Figure]:
    """Run for `hours` of plant time. Raises BenchmarkError when the gateway does not get to work."""
    with tempfile.TemporaryDirectory(prefix="decanter-resident-") as name:
        folder = Path(name)
        model = learned_model(folder)
        with software_plc(folder, speed=speed) as plc, gateway(folder, plc, model, period, speed=speed) as process:
            until_usable(plc, process)
            begun, sizes = time.monotonic(), []
            while (elapsed := time.monotonic() - begun) < 3600.0 * hours / speed:
                sizes.append((elapsed / 60.0, resident_kilobytes(process.pid)))
                time.sleep(SAMPLE_SECONDS)
    minutes, size = np.array(sizes).T
    slope, error = growth(minutes, size)
    figures = []
    for share in (0.0, 0.1, 0.25, 0.5, 0.75, 1.0):
        place, reach = int(share * (size.size - 1)), size.size // 40
        about = float(np.median(size[max(0, place - reach) : place + reach + 1]))
        figures.append(Figure(f"resident size after {share:.0%}", about / 1e3, "MB"))
    figures.append(Figure("largest resident size", float(size.max()) / 1e3, "MB"))
    return [*figures, Figure("growth over the last half", slope, "kB/min", "two standard errors of it", error)]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="A tenth of an hour of plant time.")
@click.option("--hours", default=6.0, show_default=True, type=click.FloatRange(0.05), help="Of plant time.")
@click.option("--speed", default=20.0, show_default=True, type=click.FloatRange(1.0), help="Plant seconds a second.")
@click.option("--period", default=0.02, show_default=True, type=click.FloatRange(0.02), help="Scan period (real s).")
def main(as_json: bool, quick: bool, hours: float, speed: float, period: float) -> None:
    figures = measure(0.1 if quick else hours, speed, period * speed)
    give(f"resident size of the gateway, scans of {1e3 * period:g} ms", figures, as_json=as_json)


if __name__ == "__main__":
    main()
