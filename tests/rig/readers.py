"""Which settings nobody reads: the reads are looked for in the product's own text."""

import ast
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import get_args

from pydantic import BaseModel

Owners = Mapping[str, Collection[str]]
"""The sections (names of classes) that a word may mean: a class's name, or `.key` for an attribute."""


def sections_in(*models: type[BaseModel]) -> Mapping[type[BaseModel], frozenset[str]]:
    """The tables in these models, themselves among them, each with the keys under which it stands."""
    found = defaultdict[type[BaseModel], set[str]](set)

    def enter(one: type[BaseModel], keys: set[str]) -> None:
        known, before = one in found, set(found[one])
        found[one] |= keys
        if known and found[one] == before:
            return
        for name, field in one.model_fields.items():
            for inner in _models_in(field.annotation):
                enter(inner, {name})

    for model in models:
        enter(model, set())
    return {one: frozenset(keys) for one, keys in found.items()}


def _models_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def unread(sections: Mapping[type[BaseModel], Collection[str]], texts: Iterable[str]) -> list[str]:
    """The fields, as `Class.field`, that none of these modules reads.

    A read is `x.field` where x ends with a key of the section, is annotated as the section or as a class that it is
    derived from, or was given something of these (`x = config.page`, `for x in config.notify.to`, `self._row = row`);
    or `self.field` in the section itself. A table is read by what stands in it.
    """
    owners = defaultdict[str, set[str]](set)
    for one, keys in sections.items():
        for base in one.__mro__:
            if issubclass(base, BaseModel) and base.__module__.partition(".")[0] != "pydantic":
                owners[base.__name__].add(one.__name__)
        for key in keys:
            owners[f".{key}"].add(one.__name__)
    modules = [_nodes(text) for text in texts]
    for nodes in modules:
        for word, meant in _declared(nodes, owners):
            owners[f".{word}"] |= meant
    read = {pair for nodes in modules for pair in _reads(nodes, owners)}
    return [
        f"{one.__name__}.{name}"
        for one in sections
        for name, field in one.model_fields.items()
        if (one.__name__, name) not in read and not _models_in(field.annotation)
    ]


_LOOKED_AT = (
    ast.ClassDef, ast.Attribute, ast.Assign, ast.AnnAssign, ast.NamedExpr, ast.For, ast.comprehension, ast.arg,
)  # fmt: skip


def _nodes(text: str) -> list[ast.AST]:
    return [node for node in ast.walk(ast.parse(text)) if isinstance(node, _LOOKED_AT)]


def _declared(nodes: Sequence[ast.AST], owners: Owners) -> Iterator[tuple[str, set[str]]]:
    """The attributes of other classes that are annotated as sections."""
    for node in nodes:
        for inner in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(inner, ast.AnnAssign) and isinstance(inner.target, ast.Name):
                yield inner.target.id, _meant(inner.annotation, owners, {})
            elif isinstance(inner, ast.FunctionDef) and inner.returns is not None:
                yield inner.name, _meant(inner.returns, owners, {})


def _reads(nodes: Sequence[ast.AST], owners: Owners) -> Iterator[tuple[str, str]]:
    """Of which section what is read here."""
    known = defaultdict[str, set[str]](set)
    for _ in range(2):  # what was given by a name that was itself given
        for node in nodes:
            for target, value in _given(node):
                known[target] |= _meant(value, owners, known)
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            for owner in _meant(node.value, owners, known):
                yield owner, node.attr
        elif isinstance(node, ast.ClassDef):
            for inner in ast.walk(node):
                if isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Name) and inner.value.id == "self":
                    yield from ((owner, inner.attr) for owner in owners.get(node.name, ()))


def _given(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """The names that are given something here, each with the expression or the annotation."""
    pairs: list[tuple[ast.AST, ast.AST]] = []
    if isinstance(node, ast.Assign):
        pairs = [(target, node.value) for target in node.targets]
    elif isinstance(node, ast.AnnAssign):
        pairs = [(node.target, node.annotation)]
    elif isinstance(node, ast.NamedExpr):
        pairs = [(node.target, node.value)]
    elif isinstance(node, ast.For | ast.comprehension):
        pairs = [(node.target, node.iter)]
    elif isinstance(node, ast.arg) and node.annotation is not None:
        yield node.arg, node.annotation
    for target, value in pairs:
        targets = target.elts if isinstance(target, ast.Tuple) else [target]
        several = isinstance(value, ast.Tuple) and len(value.elts) == len(targets)
        values = value.elts if isinstance(value, ast.Tuple) and several else [value] * len(targets)
        for each, what in zip(targets, values, strict=True):
            if isinstance(each, ast.Name):
                yield each.id, what
            elif isinstance(each, ast.Attribute):
                yield each.attr, what


def _meant(value: ast.AST, owners: Owners, known: Mapping[str, Collection[str]]) -> set[str]:
    """The sections that an expression or an annotation may stand for: by its last word, or by any of a call."""
    if isinstance(value, ast.Attribute):
        return {*owners.get(f".{value.attr}", ()), *known.get(value.attr, ())}
    if isinstance(value, ast.Name):
        return {*owners.get(value.id, ()), *known.get(value.id, ())}
    if isinstance(value, ast.Constant):
        return set(owners.get(value.value, ())) if isinstance(value.value, str) else set()
    return {owner for child in ast.iter_child_nodes(value) for owner in _meant(child, owners, known)}
