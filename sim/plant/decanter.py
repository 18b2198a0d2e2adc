"""The decanter by physics: four thermal masses, viscous and load-dependent friction, weather, a lagging sensor.

It holds more than a stochastic hybrid automaton can express (hidden masses, grease that thins as it warms, heat that
depends on speed times load, a feed that cools, a disturbance with memory), so that a model learned from its traces is
always somewhat wrong, as it is on a plant. The orders of magnitude are those of a 250 mm decanter with greased
bearings; no constant was fitted to a real machine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, exp, inf, pi, sqrt

import numpy as np

from sim.sha import Array, Trace

SIGNALS = (
    "MarciaDecanter",
    "MarciaPmpFango",
    "CicloAttivo",
    "AllarmeVibrazioni",
    "AllarmeTCuscinetti",
    "PresenzaAllarme",
    "Assorbimento",
    "Coppia",
    "Differenziale",
    "LivelloVibrazioni",
    "TCuscinettiRiduttore",
    "TCuscinettiAlimentazione",
    "TFango",
    "VelocitaPompa",
    "TAmbiente",
)


@dataclass(frozen=True, slots=True)
class Phase:
    """A stretch of operation: `seconds` long, drum `running` or not, the load current (A) that the feed asks for.

    `swing` (A, standard deviation) and `memory` (s) describe how the load wanders about it; `pump`: slurry is fed.
    """

    seconds: float
    running: bool
    load: float = 0.0
    swing: float = 0.0
    memory: float = 20.0
    pump: bool = True


@dataclass(frozen=True, slots=True)
class Weather:
    """The hall: mean temperature and daily swing (degC), warmest at 15 h; `slurry` is the feed's mean temperature."""

    mean: float = 17.0
    swing: float = 3.0
    slurry: float = 19.0

    def ambient(self, seconds_of_day: float) -> float:
        """Hall temperature (degC) at a time of day in seconds."""
        return self.mean + self.swing * cos(2 * pi * (seconds_of_day / 86400 - 15 / 24))


@dataclass(frozen=True, slots=True)
class DecanterPlant:
    """Constants of the machine. Rates in 1/s, heats in degC/s at nominal speed, per ampere where it says so.

    `roughness` is the standard deviation (degC/s) of a heat disturbance with the memory `roughness_memory` (s), and
    `cycle_scatter` the relative scatter of friction from one start to the next.
    """

    bearing_to_housing: float = 1 / 260
    bearing_to_oil: float = 1 / 420
    oil_to_bearing: float = 1 / 1500
    oil_to_housing: float = 1 / 1300
    housing_to_bearings: float = 1 / 2600
    housing_to_oil: float = 1 / 3400
    housing_to_hall: float = 1 / 5200
    housing_to_slurry: float = 1 / 9000
    windage: float = 0.5
    idle_heat: float = 0.019
    heat_per_ampere: float = 0.000165
    thinning: float = 0.018
    feed_side_share: float = 0.82
    oil_churning: float = 0.009
    spin_up: float = 14.0
    coast_down: float = 45.0
    idle_current: float = 62.0
    inrush: float = 290.0
    inrush_decay: float = 6.0
    roughness: float = 0.0022
    roughness_memory: float = 400.0
    cycle_scatter: float = 0.012
    sensor_lag: float = 7.0
    sensor_noise: float = 0.045
    sensor_step: float = 0.1


@dataclass(slots=True, kw_only=True)
class _PlantState:
    """What the machine remembers: temperatures (degC), speed (0..1), wander of the load, friction of this cycle."""

    gearbox: float
    feed: float
    oil: float
    housing: float
    gearbox_sensor: float
    feed_sensor: float
    speed: float = 0.0
    wander: float = 0.0
    disturbance: float = 0.0
    friction: float = 1.0
    since_start: float = 1e9
    current: float = 0.0


def _heat(plant: DecanterPlant, state: _PlantState, temperature: float) -> float:
    """Friction heat of a bearing (degC/s): viscous with speed squared, thinning as it warms, plus load times speed."""
    viscous = plant.idle_heat * state.speed**2 * exp(-plant.thinning * (temperature - 20.0))
    load = plant.heat_per_ampere * max(state.current - plant.idle_current, 0.0) * state.speed
    return state.friction * (viscous + load) + state.disturbance * state.speed


def _thermal_step(plant: DecanterPlant, state: _PlantState, hall: float, slurry: float | None, dt: float) -> None:
    """One explicit step of the four masses; every time constant is at least 100 times the step."""
    gearbox, feed, oil, housing = state.gearbox, state.feed, state.oil, state.housing
    wind = 1.0 + plant.windage * state.speed
    to_housing = plant.bearing_to_housing
    state.gearbox += dt * (
        _heat(plant, state, gearbox) - to_housing * (gearbox - housing) - plant.bearing_to_oil * (gearbox - oil)
    )
    state.feed += dt * (plant.feed_side_share * _heat(plant, state, feed) - to_housing * (feed - housing))
    churning = plant.oil_churning * state.speed**2 * exp(-plant.thinning * (oil - 20.0))
    state.oil += dt * (churning + plant.oil_to_bearing * (gearbox - oil) - plant.oil_to_housing * (oil - housing))
    state.housing += dt * (
        plant.housing_to_bearings * (gearbox + feed - 2 * housing)
        + plant.housing_to_oil * (oil - housing)
        - plant.housing_to_hall * wind * (housing - hall)
        - (plant.housing_to_slurry * (housing - slurry) if slurry is not None else 0.0)
    )


def _mechanical_step(
    plant: DecanterPlant, state: _PlantState, phase: Phase, dt: float, rng: np.random.Generator
) -> None:
    """Speed, load current and the disturbances with memory (exact Ornstein-Uhlenbeck steps)."""
    if phase.running and state.speed < 0.05 and state.since_start > 60:
        state.since_start = 0.0
        state.friction = 1.0 + plant.cycle_scatter * rng.normal()
    state.since_start += dt
    time_constant = plant.spin_up if phase.running else plant.coast_down
    # Plain floats: one number of numpy's in the state makes each operation on it, and what follows from it, three times
    # as slow.
    state.speed += (float(phase.running) - state.speed) * -float(np.expm1(-dt / time_constant))
    # sqrt(1 - keep^2) holds the standard deviation at `swing` whatever the step is.
    keep = exp(-dt / phase.memory)
    state.wander = keep * state.wander + phase.swing * sqrt(1 - keep**2) * rng.normal()
    keep = exp(-dt / plant.roughness_memory)
    state.disturbance = keep * state.disturbance + plant.roughness * sqrt(1 - keep**2) * rng.normal()
    wanted = 0.0
    if phase.running:
        inrush = plant.inrush * exp(-state.since_start / plant.inrush_decay)
        wanted = max(plant.idle_current, phase.load + state.wander) + inrush
    state.current += (wanted - state.current) * -float(np.expm1(-dt / (2.5 if phase.running else 0.4)))


def _reading(value: float, noise: float, step: float, rng: np.random.Generator) -> float:
    """A transmitter's reading: noise added, then rounded to its step."""
    return round(round((value + noise * rng.normal()) / step) * step, 6)


def _row(
    plant: DecanterPlant,
    state: _PlantState,
    *,
    phase: Phase,
    share: float,
    hall: float,
    slurry: float,
    rng: np.random.Generator,
) -> list[float]:
    """One row of readings in the order of SIGNALS; `share` of the feed that the phase asks for is given."""
    feeding = phase.pump and phase.running
    current = min(350.0, max(0.0, _reading(state.current, 0.6 if state.current > 1 else 0.0, 0.1, rng)))
    torque = max(0.0, _reading(0.28 * max(state.current - 45.0, 0.0) * state.speed, 0.15, 0.1, rng))
    vibration = max(0.0, _reading(0.4 + 2.4 * state.speed**2 + 0.004 * state.current * state.speed, 0.05, 0.01, rng))
    gearbox = _reading(state.gearbox_sensor, plant.sensor_noise, plant.sensor_step, rng)
    feed = _reading(state.feed_sensor, plant.sensor_noise, plant.sensor_step, rng)
    hot, shaking = float(max(gearbox, feed) > 80.0), float(vibration > 9.0)
    return [
        float(phase.running),
        float(feeding),
        float(phase.running and phase.load > 0),
        shaking,
        hot,
        float(bool(hot or shaking)),
        current,
        torque,
        max(0.0, _reading(12.0 * state.speed, 0.02, 0.01, rng)),
        vibration,
        gearbox,
        feed,
        _reading(slurry, 0.05, 0.1, rng),
        _reading(70.0 * share if feeding else 0.0, 0.3 if feeding else 0.0, 0.1, rng),
        _reading(hall, 0.05, 0.1, rng),
    ]


class LiveDecanter:
    """The machine moved on row by row, so that whoever controls it can act between two rows.

    `times` (n,) are the rows' in s since `start` (s UTC), `bearing` the bearings' temperature (degC) at 0. Where a
    bearing's sensor reaches `trip_at` (degC), the drum stops for `trip_rest` seconds; `trips` are the times
    (s since `start`) at which it did. All that is drawn is drawn step by step whatever is asked of the machine, so that
    of two runs with the same draws one stays the other until they are controlled differently.
    """

    signals = SIGNALS

    def __init__(
        self,
        phases: Sequence[Phase],
        *,
        times: Array,
        start: float,
        bearing: float,
        weather: Weather,
        plant: DecanterPlant,
        rng: np.random.Generator,
        step: float = 0.5,
        trip_at: float = inf,
        trip_rest: float = inf,
    ) -> None:
        self.times, self.start, self.trip_at, self.trip_rest = times, start, trip_at, trip_rest
        self.trips: list[float] = []
        self._phases, self._weather, self._plant, self._rng, self._step = phases, weather, plant, rng, step
        self._ends = np.cumsum([phase.seconds for phase in phases]).tolist()
        self._now, self._phase, self._rows = 0.0, 0, 0
        hall = weather.ambient(start % 86400)
        self._state = _PlantState(
            gearbox=bearing,
            feed=bearing - 0.3,
            oil=bearing,
            housing=0.6 * bearing + 0.4 * hall,
            gearbox_sensor=bearing,
            feed_sensor=bearing - 0.3,
        )

    def advance(self, begin: float) -> "LiveDecanter":
        """The machine moved on to `begin` (s since `start`) with a full feed; the rows before are left out."""
        while self.times[self._rows] < begin:
            self.row()
        self.times, self._rows = self.times[self._rows :], 0
        return self

    def row(self, feed: float = 1.0) -> list[float]:
        """The next row's readings in the order of `signals`, with the feed at this share (0..1) since the one before.

        Raises IndexError after the last row.
        """
        target = float(self.times[self._rows])
        plant, weather, state, rng = self._plant, self._weather, self._state, self._rng
        while True:
            while self._phase < len(self._ends) - 1 and self._now >= self._ends[self._phase]:
                self._phase += 1
            phase = self._phases[self._phase]
            if self.trips and self._now < self.trips[-1] + self.trip_rest:
                phase = replace(phase, running=False, load=0.0, pump=False)
            elif feed != 1.0:
                load = plant.idle_current + feed * (phase.load - plant.idle_current)
                phase = replace(phase, load=load if phase.load else 0.0)
            hall = weather.ambient((self.start + self._now) % 86400)
            slurry = weather.slurry + 0.1 * (hall - weather.mean)
            dt = min(self._step, target - self._now)
            if dt <= 0:
                break
            _mechanical_step(plant, state, phase, dt, rng)
            _thermal_step(plant, state, hall, slurry if phase.pump and phase.running else None, dt)
            # The sensors follow the bearings with a lag: exact for bearings that stand still during the step.
            keep = exp(-dt / plant.sensor_lag)
            state.gearbox_sensor = state.gearbox + (state.gearbox_sensor - state.gearbox) * keep
            state.feed_sensor = state.feed + (state.feed_sensor - state.feed) * keep
            self._now += dt
            if phase.running and max(state.gearbox_sensor, state.feed_sensor) >= self.trip_at:
                self.trips.append(self._now)
        self._rows += 1
        return _row(plant, state, phase=phase, share=feed, hall=hall, slurry=slurry, rng=rng)


def simulate_decanter(
    phases: Sequence[Phase],
    *,
    seed: int,
    name: str,
    period: float = 1.11,
    jitter: float = 0.15,
    start: float = 0.0,
    bearing: float | None = None,
    weather: Weather | None = None,
    plant: DecanterPlant | None = None,
    step: float = 0.5,
) -> Trace:
    """A synthetic trace of the phases, one row every `period` seconds on average, its steps scattered by `jitter`.

    `start` is the absolute time of the first row (s UTC), `bearing` the bearings' temperature then (degC; default: the
    hall's), `step` the integration step (s). The same arguments give the same trace. Raises ValueError when there is
    nothing to simulate.
    """
    if not phases or period <= 0 or step <= 0:
        raise ValueError("a decanter needs at least one phase, a positive period and a positive step")
    plant, weather = plant or DecanterPlant(), weather or Weather()
    rng = np.random.default_rng(seed)
    # Sampling instants: the period with log-normal scatter of mean 1, in milliseconds as a PLC stamps them.
    duration = sum(phase.seconds for phase in phases)
    steps = period * np.exp(jitter * rng.normal(size=int(duration / period * 1.5) + 10) - jitter**2 / 2)
    times = np.round(np.concatenate([[0.0], np.cumsum(steps)]), 3)
    times = times[times <= duration]
    decanter = LiveDecanter(
        phases,
        times=times,
        start=start,
        bearing=weather.ambient(start % 86400) if bearing is None else bearing,
        weather=weather,
        plant=plant,
        rng=rng,
        step=step,
    )
    rows = np.array([decanter.row() for _ in times])
    return Trace(
        name=name,
        times=start + times,
        signals={signal: rows[:, column].copy() for column, signal in enumerate(SIGNALS)},
        origin=f"simulated decanter {name}, seed {seed}",
        synthetic=True,
    )
