"""Expectations and courses: what is asked of the runs themselves and not of a probability."""

from math import sqrt

import numpy as np
from scipy.special import stdtrit

from sim.checking.query import tree as q
from sim.checking.smc.record import Answer, Settings, interval, run_notes
from sim.checking.smc.runs import Report, courses, extremes
from sim.checking.smc.start import Start


def expectation(query: q.Expectation, start: Start, settings: Settings, report: Report) -> Answer:
    """The mean of a course's extreme over the runs, with a Student interval."""
    runs = settings.runs or query.runs
    greatest = query.extreme == "max"
    found, totals, notes = extremes(
        start.world, query.expression, query.bound, runs, settings.seed, greatest=greatest, report=report
    )
    mean, numbers = found.mean, {}
    said = f"E({query.extreme}) = {mean:.4g} (one run)"
    if runs > 1:
        deviation = sqrt(found.squares / (runs - 1))
        half = float(stdtrit(runs - 1, 1.0 - settings.alpha / 2.0)) * deviation / sqrt(runs)
        numbers = {"low": mean - half, "high": mean + half, "sigma": deviation}
        said = f"E({query.extreme}) = {interval(mean, numbers['low'], numbers['high'], settings)}"
        said += f"; over the runs sigma {deviation:.4g}, from {found.least:.4g} to {found.greatest:.4g}"
    numbers = {"mean": mean, **numbers, "least": found.least, "greatest": found.greatest}
    return Answer(
        query,
        "expectation",
        said,
        None,
        numbers,
        "mean of the runs, Student's t",
        runs,
        settings.seed,
        start.words,
        (*notes, *run_notes(totals)),
    )


def simulation(query: q.Simulation, start: Start, settings: Settings, report: Report) -> Answer:
    """The courses of the query's expressions."""
    runs = settings.runs or query.runs
    report(f"{runs} runs", 0.0)
    found, totals, notes = courses(start.world, query.expressions, query.bound, runs, settings.seed)
    numbers: dict[str, float] = {}
    for row, label in enumerate(query.labels):
        last = np.array([course.values[row, -1] for course in found])
        numbers |= {f"{label}: mean at the end": float(last.mean())}
        numbers |= {f"{label}: least": min(float(course.values[row].min()) for course in found)}
        numbers |= {f"{label}: greatest": max(float(course.values[row].max()) for course in found)}
    said = f"{runs} courses of {', '.join(query.labels)} over {query.bound:.6g} s"
    notes = (*notes, *run_notes(totals))
    rule = "courses of the runs, at the ends of their steps"
    return Answer(
        query, "simulation", said, None, numbers, rule, runs, settings.seed, start.words, notes, courses=found
    )
