"""What is strange of a cycle in an operator's words, in each language of the one table of texts."""

from gateway.outside.status import StrangeStatus
from gateway.outside.texts.words import Words
from sim.familiarity import FEATURES, StrangeThing


def strange_sentence(words: Words, thing: StrangeThing | StrangeStatus) -> str:
    """The sentence; "" where nothing is strange. Numbers are those that the features are told by."""
    if not thing.kind:
        return ""
    if not thing.features:
        return words.say(f"strange.{thing.kind}", value=words.number(thing.values[0], 1))
    shown = [_feature(words, name, value) for name, value in zip(thing.features, thing.values, strict=True)]
    if thing.bound is None:
        return words.say("strange.together", one=shown[0], other=shown[-1])
    bound = words.number(thing.bound, FEATURES[thing.features[0]].digits)
    return words.say(f"strange.{thing.kind}", what=shown[0], bound=bound)


def _feature(words: Words, name: str, value: float) -> str:
    return words.say(f"feature.{name}", value=words.number(value, FEATURES[name].digits))
