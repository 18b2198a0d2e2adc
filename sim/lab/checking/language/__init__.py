"""The query language: text to tree and back, against the names of one model."""

from sim.lab.checking.language.grammar import QueryError
from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.language.printing import query_text, uppaal_refusal
