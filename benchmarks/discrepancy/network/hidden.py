"""What is hidden in the network: physics of each effect at a strength, not by the catalogue's formulas."""

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.discrepancy.network.duty import DAY, Duty, orders, smoothed
from benchmarks.discrepancy.network.thermal import Addition
from benchmarks.discrepancy.operation import Array

Hidden = Callable[[Duty, float, np.random.Generator], Addition]


def _about(column: Array, running: Array) -> Array:
    """The column without its mean while running."""
    return np.asarray(running * (column - np.average(column, weights=running)))


def winding(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Copper losses of the motor, felt through its flange a little later."""
    return Addition(heat=s * 200.0 * smoothed((duty.load / 250.0) ** 2, rng.uniform(20.0, 90.0)))


def slip(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """A coupling that slips above a load and passes no more: a soft limit."""
    knee = rng.uniform(180.0, 230.0)
    passed = -40.0 * np.logaddexp(0.0, (duty.load - knee) / 40.0)
    return Addition(heat=s * 2.0 * duty.running * passed)


def scroll(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Axial thrust of the scroll: friction that grows a little faster than its torque."""
    return Addition(heat=s * 150.0 * duty.running * (duty.torque / 50.0) ** rng.uniform(1.05, 1.25))


def gear(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Churning oil of the gear: a power of the differential speed between laminar and turbulent."""
    return Addition(heat=s * 100.0 * duty.running * (duty.differential / 15.0) ** rng.uniform(1.0, 1.6))


def rattle(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Rollers that skid while it vibrates."""
    return Addition(heat=s * 60.0 * duty.running * np.maximum(duty.vibration - 0.8, 0.0) ** rng.uniform(0.9, 1.3))


def draught(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """The hall follows the weather through its walls."""
    return Addition(hall=s * smoothed(duty.ambient - 18.0, rng.uniform(300.0, 1500.0)))


def cooler(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Water of the cooler runs with the slurry pump, through a jacket that must fill first."""
    wet = smoothed(duty.slurry, rng.uniform(30.0, 120.0))
    return Addition(cooling=s * 6.0 * wet, sink=rng.uniform(12.0, 18.0))


def stream(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Slurry washes the hub: a turbulent film towards its own temperature."""
    film = (duty.speed / 70.0) ** 0.8
    return Addition(cooling=s * 5.0 * smoothed(film, rng.uniform(30.0, 90.0)), sink=duty.feed)


def bowl(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """The bowl takes the slurry's temperature and hands heat on by a shaft of its own, whatever the bearing's is."""
    gap = duty.slurry * (duty.feed - rng.uniform(22.0, 28.0))
    return Addition(heat=s * 12.0 * smoothed(gap, rng.uniform(60.0, 240.0)))


def pedestal(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """A cast frame behind a painted joint stores heat for hours."""
    frame = s * 6.0
    return Addition(frame=frame, frame_capacity=frame * rng.uniform(3500.0, 7000.0))


def channelling(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Cold grease is churned until it has made its channels: power falls faster than it ends."""
    since = duty.since_start
    return Addition(heat=s * 250.0 * duty.running / (1.0 + (since / rng.uniform(400.0, 1100.0)) ** 2))


def well(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """The sensor's paste has dried out: its well lags."""
    return Addition(lag=80.0 * s)


def reseated(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """The sensor was taken out and put back some minutes later, elsewhere."""
    at = rng.uniform(0.2, 0.5) * duty.running.size
    return Addition(shifted=float(rng.choice([-1.0, 1.0])) * s * (duty.seconds > at))


def wear(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Spalls that breed spalls: heat grows, slowly first."""
    age = duty.seconds / duty.running.size
    growth = rng.uniform(0.3, 1.2)
    return Addition(heat=s * 150.0 * duty.running * np.expm1(growth * age) / growth)


def fan(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """A fan with a thermostat."""
    opens = rng.uniform(41.0, 45.0)
    return Addition(fan=8.0 * s, opens=opens, closes=opens - rng.uniform(2.0, 4.0))


def bare_housing(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """The housing's own surface radiates and convects beside the draught."""
    return Addition(radiating=0.5 * s)


def relubricated(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Grease is filled in twice and takes hours to spread."""
    heat = np.zeros(duty.running.size)
    for share in (rng.uniform(0.1, 0.25), rng.uniform(0.4, 0.6)):
        age = duty.seconds - share * duty.running.size
        heat += np.where(age > 0, np.exp(-np.maximum(age, 0.0) / rng.uniform(8000, 20000)), 0.0)
    return Addition(heat=s * 250.0 * duty.running * heat)


def seal(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """A seal that rubs for some quarters of an hour, nobody knows when."""
    return Addition(heat=s * 200.0 * duty.running * (orders(rng, duty.running.size, (1500, 6000), (0.0, 1.0)) < 0.25))


def neighbour(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """A machine next door, by a plan of its own."""
    return Addition(heat=s * 120.0 * smoothed(orders(rng, duty.running.size, (4000, 16000), (-1.0, 1.0)), 1200.0))


def crew(duty: Duty, s: float, rng: np.random.Generator) -> Addition:
    """Every other day another polymer, another friction."""
    odd = (duty.seconds // DAY + rng.integers(2)) % 2
    return Addition(heat=s * 150.0 * duty.running * (odd - 0.5))


INSIDE: Mapping[str, tuple[str, Hidden]] = {
    "winding": ("quadratic-current-heating", winding),
    "slip": ("current-saturation", slip),
    "scroll": ("torque-friction", scroll),
    "gear": ("speed-friction", gear),
    "rattle": ("vibration-friction", rattle),
    "draught": ("ambient-coupling", draught),
    "cooler": ("pump-cooling", cooler),
    "stream": ("feed-temperature-coupling", stream),
    "bowl": ("feed-temperature-coupling", bowl),
    "pedestal": ("housing-thermal-mass", pedestal),
    "channelling": ("startup-churning", channelling),
    "well": ("sensor-lag", well),
    "reseated": ("sensor-offset-step", reseated),
    "wear": ("wear-drift", wear),
    "fan": ("thermostatic-cooling", fan),
    "bare-housing": ("radiation-loss", bare_housing),
}
"""hidden -> (the name that a perfect answer gives, how it is made)."""
OUTSIDE: Mapping[str, Hidden] = {
    "relubricated": relubricated,
    "seal": seal,
    "neighbour": neighbour,
    "crew": crew,
}
"""What no name stands for."""
