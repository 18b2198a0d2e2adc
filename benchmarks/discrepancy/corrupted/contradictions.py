"""What a diagnosis says against its own figures, and what of it is no sentence or no number."""

from collections.abc import Iterator, Mapping
from itertools import chain
from math import isfinite
from re import search
from typing import Any

NO_WORDS = r"\b(?:nan|inf|None)\b|[{}]|  |\s[.,;]|\.\.|array\(|e\+\d\d"
"""What stands in no sentence: numbers that are none, values as a program has them, and what a missing word leaves."""
MAY_BE_NULL = frozenset({"excess_removed", "ci95", "refused_refit"})
"""Keys of the proof that may have no value."""
NEAR = 1.0 + 1e-6
"""Times which two figures may be apart that are the same."""

Document = Mapping[str, Any]


def contradictions(found: Document) -> list[str]:
    """One sentence for each, of a `diagnosis.json`; nothing where it holds together."""
    return list(chain(_words(found), _numbers(found), _proof(found), _verdict(found), _beside(found)))


def _words(found: Document) -> Iterator[str]:
    held = found["held_out"] or {}
    beside = (held.get("sentence", "none"), *found["look_at"], *found["reasons"], *found["untested"].values())
    for text in (found["sentence"], *beside):
        if not text.strip() or search(NO_WORDS, text):
            yield f"are no words: {text}"
    if not found["sentence"].endswith("."):
        yield f"is no sentence: {found['sentence']}"


def _numbers(found: Document) -> Iterator[str]:
    held = {key: value for key, value in (found["held_out"] or {}).items() if key not in MAY_BE_NULL}
    parts = {"held_out": held, "floor": found["floor"] or {}}
    parts |= {key: found[key] for key in ("settings", "localisation", "unexplained", "laws", "effects")}
    for path in chain(*(_nulls(value, key) for key, value in parts.items())):
        if not path.endswith(".line"):
            yield f"{path} is no number"


def _nulls(value: Any, path: str) -> Iterator[str]:
    """The paths of what has no value."""
    if value is None:
        yield path
    inner = (
        value.items() if isinstance(value, Mapping) else [("", one) for one in value] if isinstance(value, list) else ()
    )
    for key, one in inner:
        yield from _nulls(one, f"{path}.{key}" if key else path)


def _proof(found: Document) -> Iterator[str]:
    held, floor = found["held_out"], found["floor"]
    if held is None or floor is None:
        if found["verdict"] != "too-little-data":
            yield "a verdict without a proof"
        return
    low, high = floor["interval"]
    if not 0.0 < low <= floor["value"] * NEAR or floor["value"] > high * NEAR:
        yield f"the floor {floor['value']:.3g} lies outside of its interval {low:.3g} to {high:.3g}"
    if abs(held["noise_floor"] / floor["value"] - 1.0) > NEAR - 1.0:
        yield f"two floors, {held['noise_floor']:.3g} and {floor['value']:.3g}"
    if held["cycles"] != len(held["per_cycle"]) or held["cycles"] < 1:
        yield f"{held['cycles']} cycles, and errors of {len(held['per_cycle'])}"
    for when, key in (("before", "rmse_before"), ("after", "rmse_after")):
        each = [one[when] for one in held["per_cycle"]]
        if each and not min(each) <= held[key] * NEAR <= max(each) * NEAR**2:
            yield f"the error {when}, {held[key]:.3g}, lies outside of its cycles'"
    removed, interval = held["excess_removed"], held["ci95"]
    if (removed is None) != (interval is None) or (removed is not None and removed > 1.0):
        yield f"of the excess {removed} is removed, {interval}"
    if removed is not None and held["rmse_before"] <= held["noise_floor"]:
        yield "a share is removed of an excess that there is not"


def _verdict(found: Document) -> Iterator[str]:
    verdict, effects, held, floor = (found[key] for key in ("verdict", "effects", "held_out", "floor"))
    if (verdict in ("named", "class")) != bool(effects):
        yield f"{verdict} with {len(effects)} names"
    if verdict == "class" and all(len(one["class"]) == 1 for one in effects):
        yield "a class of one"
    if verdict == "agree":
        felt = held["rmse_before"] ** 2 - floor["value"] ** 2 > (0.5 * found["settings"]["sensor_sigma"]) ** 2
        if felt and held["rmse_before"] > floor["interval"][1] * NEAR:
            yield f"agrees at {held['rmse_before']:.3g}, noise alone makes {floor['interval'][1]:.3g} at most"
        if found["material"] or found["unexplained"] or "began" in found or found["laws"]:
            yield "agrees with what is material, lies somewhere, begins or follows a law"
    if verdict == "unexplained" and not (found["material"] or "began" in found):
        yield "unexplained without a gap that matters"
    if effects and held["rmse_after"] >= held["rmse_before"]:
        yield f"named with {held['rmse_after']:.3g} after {held['rmse_before']:.3g}"
    if effects and held["rmse_before"] <= held["noise_floor"]:
        yield f"named at {held['rmse_before']:.3g}, beneath the floor of {held['noise_floor']:.3g}"


def _beside(found: Document) -> Iterator[str]:
    for one in found["effects"]:
        if not 0.5 <= one["confidence"] <= 1.0 or one["name"] != one["class"][0]:
            yield f"{one['name']} with {one['confidence']:.3g}"
        for key, value in one["parameters"].items():
            if not isfinite(value):
                yield f"{key} of {one['name']} is no number"
        if one["confidence"] + found.get("none_of_these", 0.0) > NEAR:
            yield f"{one['name']} and none of these are more than certain"
    for place in (*found["localisation"], *found["unexplained"]):
        (low, high), (speaking, all_) = place["seconds"], map(int, place["cycles"].split("/"))
        if not 0.0 <= place["share"] <= NEAR or not 0.0 <= low <= high or not 0 < speaking <= all_:
            yield f"a place of {place['share']:.3g}, {low:.3g} to {high:.3g} s, {place['cycles']} cycles"
    if began := found.get("began"):
        low, high = began["interval"]
        if not low <= began["time"] <= high or min(began["cycles"].values()) < 1:
            yield f"begins at {began['time']:.0f}, between {low:.0f} and {high:.0f}"
    for shift in found["parameter_shift"]:
        if shift["change"] is not None and abs(shift["change"]) > 1.0:
            yield f"{shift['parameter']} in {shift['location']} changes by {shift['change']:.0%} of itself"
