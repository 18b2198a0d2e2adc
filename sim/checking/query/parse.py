"""A query's text is read into its tree, against the names of one model."""

from sim.checking.query.grammar import QueryError, syntax
from sim.checking.query.resolve import names_of, resolve
from sim.checking.query.tree import Query
from sim.sha.automaton import SHA
from sim.sha.model import Model

__all__ = ["QueryError", "parse_query"]


def parse_query(text: str, model: Model | SHA, temperature: str = "Temp") -> Query:
    """The query that `text` asks of a model; docs/queries.md is the language's reference.

    An automaton alone has no name for its temperature: `temperature` gives it, and is not looked at for a Model.
    Raises QueryError (a ValueError) with the column, what stands there and what would be right.
    """
    sha, name = (model.sha, model.temperature) if isinstance(model, Model) else (model, temperature)
    return resolve(syntax(text), text, names_of(sha, name))
