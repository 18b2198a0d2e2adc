"""A text that people read: English, and what it is in the other languages that the page speaks."""

import re

_DECIMAL = re.compile(r"-?\d+\.\d+")


class Phrase(str):
    """An English text with its translations; one that is missing ("") is the English one, marked as such.

    The places of what is filled in, such as {tag}, stand in all of them.
    """

    it: str
    de: str

    def __new__(cls, en: str, *, it: str = "", de: str = "") -> "Phrase":
        """The text and its translations."""
        phrase = super().__new__(cls, en)
        phrase.it, phrase.de = it, de
        return phrase

    def fill(self, **parts: object) -> "Phrase":
        """It with its parts in their places in every language; a part that is a phrase is said in that language, and a
        number written with its decimal sign."""

        def say(language: str) -> dict[str, str]:
            own = {name: getattr(part, language, str(part)) for name, part in parts.items()}
            return {name: text.replace(".", ",") if _DECIMAL.fullmatch(text) else text for name, text in own.items()}

        return Phrase(self.format_map(parts), it=self.it.format_map(say("it")), de=self.de.format_map(say("de")))

    @property
    def whole(self) -> bool:
        """Whether it is there in every language."""
        return bool(self and self.it and self.de)


def translate(language: str, text: str) -> str:
    """A text in a language ("en", "it" or "de"); in English with a mark where there is no translation."""
    if language == "en":
        return str(text)
    translated: str = getattr(text, language, "")
    return translated or f"{text} (en)"
