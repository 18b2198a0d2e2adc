"""A diagnosis of every verdict, made by hand: what the report, the pictures and the document have to be able to say."""

from dataclasses import replace
from math import inf, nan

import numpy as np

from sim.lab.discrepancy.diagnosis import (
    Ceiling,
    Diagnosis,
    DiagnosisCourse,
    GapBeginning,
    HeatPlace,
    HeldOutProof,
    MissingHeat,
    NamedEffect,
    NoiseFloor,
    Shift,
    TriedEffect,
    Verdict,
)

EVIL = '<script>alert(1)</script> & "quotes" $x$'
LOCATIONS = ("OFF/0-100", "ON/0-100", "ON/100-200", "ON/200-300")


def course(cycles: int = 11, held_out: int = 4, *, after: bool = True, seed: int = 1) -> DiagnosisCourse:
    """Cycles of three hours with 60 windows each; in one location, soon after the start, the plant is warmer."""
    rng = np.random.default_rng(seed)
    minutes = np.linspace(1.0, 179.0, 60)
    place = np.where(minutes > 120, 0, 1 + (minutes // 40).astype(int) % 3)
    since = np.where(minutes > 120, minutes - 120, minutes) * 60.0
    shape = np.where(minutes > 120, 45 * np.exp(-(minutes - 120) / 30), 45 * (1 - np.exp(-minutes / 30)))
    gap = np.where((place == 3) & (minutes < 120), 40.0, 2.0)
    tiles = [np.tile(column, cycles) for column in (minutes, since, shape, gap)]
    number = np.repeat(np.arange(cycles), minutes.size)
    times = 1.7e9 + number * 10_800.0 + tiles[0] * 60.0
    reading = 20 + tiles[2] + 0.1 * rng.normal(size=times.size)
    before = reading - 0.02 * tiles[3] + 0.1 * rng.normal(size=times.size)
    names = tuple(LOCATIONS[one] for one in np.tile(place, cycles))
    nothing = np.full(times.size, nan)
    heat = tiles[3] + 5.0 * rng.normal(size=times.size)
    left = 5.0 * rng.normal(size=times.size)
    return DiagnosisCourse(
        times,
        reading,
        before,
        reading + 0.1 * rng.normal(size=times.size) if after else nothing,
        (number >= cycles - held_out).astype(float),
        heat,
        left if after else nothing,
        names,
        tiles[1],
        number.astype(float),
    )


def held_out(*, after: bool = True) -> HeldOutProof:
    rows = tuple((0.55 + 0.05 * n, 0.21 + 0.01 * n if after else 0.55 + 0.05 * n, 0.2) for n in range(4))
    if not after:
        return HeldOutProof(4, 4, 0.7, 0.63, 0.63, 0.2, 0.0, (0.0, 0.0), rows)
    return HeldOutProof(4, 4, 0.7, 0.63, 0.225, 0.2, 0.97, (0.9, 1.0), rows)


def missing(whole: DiagnosisCourse) -> MissingHeat:
    """The missing heat of that course, as sure as a tenth of its range."""
    heat = np.where(np.isfinite(whole.heat_before), whole.heat_before, 0.0)
    running = np.array([name.startswith("ON") for name in whole.location])
    return MissingHeat(
        times=whole.times, mean=heat, low=heat - 4.0, high=heat + 4.0, running=running, held_out=whole.held_out > 0.5
    )


def beginning() -> GapBeginning:
    """Since the fifth of eleven cycles the machine is warmer."""
    begin = 1.7e9 + 4 * 10_800.0
    return GapBeginning(
        time=begin, interval=(begin - 10_800.0, begin), before=4, after=7, moves=1.2, running=True, p=0.0002
    )


def candidate(name: str, gain: float, fate: str, *, confirmed: bool = True, twins: tuple[str, ...] = ()) -> TriedEffect:
    return TriedEffect(
        name,
        f"what {name} is",
        1,
        gain,
        confirmed,
        0.4,
        5.2,
        nan if gain < 1 else 3.1,
        (9, 11),
        {"gain": 0.001, "tau": 240.0},
        twins,
        ("wear-drift",),
        ("Assorbimento",),
        f"the experiment for {name}",
        fate,
    )


def effect(members: tuple[str, ...]) -> NamedEffect:
    return NamedEffect(
        members[0],
        members,
        0.97,
        41.2,
        12.5,
        {"loss": 2.1e-4, "sink": -3.5},
        {"loss": 1.2e-5},
        {"pump": "MarciaPmpFango"},
        3.4,
        "the slurry pump cools the bearing while it runs",
        "run for half an hour at one load with the pump on, then off",
    )


PLACE = HeatPlace(
    location="ON/200-300",
    after="W_ON",
    seconds=(0.0, 240.0),
    share=0.62,
    heat=38.5,
    cycles=(9, 11),
    p=0.001,
    correlates="MarciaPmpFango",
)
LATE = HeatPlace(
    location="OFF/0-100",
    after="W_OFF",
    seconds=(1800.0, inf),
    share=0.08,
    heat=-2.5,
    cycles=(8, 11),
    p=0.03,
    correlates="",
)
SHIFT = Shift(location="ON/200-300", parameter="target", before=61.2, after=63.9, unit="degC", change=0.05, sigma=4.1)


def agree() -> Diagnosis:
    return Diagnosis(
        verdict="agree",
        sentence="Model and data agree within noise on 11 cycles.",
        reasons=("the free runs are at the noise floor",),
        effects=(),
        shifts=(SHIFT,),
        places=(),
        unexplained=(),
        ceiling_before=Ceiling(0.01, 0.4, 1.0, ()),
        ceiling_after=None,
        candidates=(candidate("wear-drift", 0.4, "below the threshold", confirmed=False),),
        material=False,
        traces=(),
        absorbed=None,
        untested={"ambient-coupling": "no trace has a signal for the role 'ambient' (TAmbiente)"},
        held_out=held_out(after=False),
        floor=NoiseFloor(0.2, (0.16, 0.25), np.arange(4), np.full(4, 0.2), "what equal cycles differ by"),
        began=None,
        course=course(after=False),
        settings={"seed": 0.0, "threshold (nats)": 7.3, "sensor noise (degC)": 0.05},
        model_before="plant",
        model_after=None,
        missing_heat=missing(course(after=False)),
    )


def of(verdict: Verdict) -> Diagnosis:
    """A diagnosis with this verdict."""
    if verdict == "agree":
        return agree()
    if verdict == "too-little-data":
        nothing = replace(agree(), verdict=verdict, sentence="There is 1 cycle; at least 4 are needed.", shifts=())
        return replace(
            nothing,
            candidates=(),
            held_out=None,
            floor=None,
            course=None,
            ceiling_before=None,
            untested={},
            missing_heat=None,
        )
    if verdict == "unexplained":
        gap = replace(agree(), verdict=verdict, sentence="There is a gap that no known effect explains.", shifts=())
        return replace(gap, places=(PLACE, LATE), unexplained=(PLACE,), ceiling_before=Ceiling(0.4, 0.001, 2.0, ()))
    members = ("pump-cooling", "feed-temperature-coupling") if verdict == "class" else ("pump-cooling",)
    others = [
        candidate("pump-cooling", 41.2, "named", twins=members[1:]),
        candidate("torque-friction", 28.7, "12.5 nats behind pump-cooling"),
        candidate("sensor-lag", 0.2, "below the threshold", confirmed=False),
        candidate("radiation-loss", -inf, "not visible in these data", confirmed=False),
    ]
    return replace(
        agree(),
        verdict=verdict,
        sentence="The slurry pump cools the bearing while it runs: pump-cooling closes 97 % of the gap.",
        effects=(effect(members),),
        shifts=(),
        places=(PLACE, LATE),
        ceiling_before=Ceiling(0.42, 0.001, 2.0, (("pump", 0.5), ("since start", 0.2))),
        ceiling_after=Ceiling(0.02, 0.3, 1.0, ()),
        candidates=tuple(others),
        held_out=held_out(),
        course=course(),
        model_after="model",
        none_of_these=0.02,
    )
