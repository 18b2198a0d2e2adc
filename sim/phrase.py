"""A text that people read: English, and what it is in the other languages that the page speaks."""


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

    @property
    def whole(self) -> bool:
        """Whether it is there in every language."""
        return bool(self and self.it and self.de)


def said_in(language: str, text: str) -> str:
    """A text in a language ("en", "it" or "de"); in English with a mark where there is no translation."""
    if language == "en":
        return str(text)
    translated: str = getattr(text, language, "")
    return translated or f"{text} (en)"
