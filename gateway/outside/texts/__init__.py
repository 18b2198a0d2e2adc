"""What people read in their own language: one table of texts, and the sentences that more than the page shows."""

from gateway.outside.texts.strange import strange_sentence
from gateway.outside.texts.words import LANGUAGES, Words, all_words, preferred_language
