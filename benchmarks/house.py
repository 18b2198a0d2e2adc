"""The house in figures, by `ast` and nothing else: `python -m benchmarks.house [--root DIR] [--tree]`.

Lines and modules by folder, how long functions are, private functions and the share of them called once, comments per
100 lines of code, calls with more than five positional arguments, class names that stand for several classes, imports
inside functions. The figures describe; none is a limit.
"""

import ast
import io
import re
import statistics
import tokenize
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import click

FLOORS = ("drivers", "sim", "gateway")
POSITIONAL = 5


@dataclass
class Figures:
    """What is counted over a set of modules."""

    modules: Counter[str] = field(default_factory=Counter)
    lines: Counter[str] = field(default_factory=Counter)
    sentences: dict[str, str] = field(default_factory=dict)
    code: int = 0
    comments: int = 0
    lengths: list[int] = field(default_factory=list)
    private: int = 0
    called_once: int = 0
    positional: list[str] = field(default_factory=list)
    inner_imports: list[str] = field(default_factory=list)
    classes: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))


def measure(root: Path, folders: tuple[str, ...], *, text: bool = True) -> Figures:
    """Counts every Python module below the folders of `root`; without `text` lines of code and comments stay 0."""
    figures = Figures()
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            _count(path, str(path.relative_to(root)), figures, in_text=text)
    return figures


def _count(path: Path, place: str, figures: Figures, *, in_text: bool) -> None:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))  # once: walking is what this module's time goes to
    room = str(Path(place).parent)
    figures.modules[room] += 1
    figures.lines[room] += len(text.splitlines())
    if Path(place).name == "__init__.py":
        figures.sentences[room] = (ast.get_docstring(tree) or "").partition("\n")[0]
    if in_text:
        _count_text(text, nodes, figures)
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    figures.lengths += [(node.end_lineno or node.lineno) - node.lineno + 1 for node in functions]
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    hidden = [name for name in names if name.startswith("_") and not name.startswith("__")]
    figures.private += len(hidden)
    for name in hidden:
        uses = len(re.findall(rf"\b{re.escape(name)}\b", text)) - 1  # the definition itself
        figures.called_once += uses == 1
    for node in nodes:
        if isinstance(node, ast.Call) and len(node.args) > POSITIONAL:
            figures.positional.append(f"{place}:{node.lineno}")
        if isinstance(node, ast.ClassDef):
            figures.classes[node.name].append(place)
    # What a function imports is indented; most modules have no such import, and need no second walk.
    if any(isinstance(node, ast.Import | ast.ImportFrom) and node.col_offset for node in nodes):
        figures.inner_imports += [
            f"{place}:{node.lineno}"
            for function in functions
            for node in ast.walk(function)
            if isinstance(node, ast.Import | ast.ImportFrom)
        ]


def _count_text(text: str, nodes: list[ast.AST], figures: Figures) -> None:
    """Comments and lines of code: the tokens take as long as all the rest."""
    tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    figures.comments += sum(token.type == tokenize.COMMENT for token in tokens)
    # A line of code is one on which a token other than comments, strings standing alone and white space begins.
    skipped = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    documented = {
        line
        for node in nodes
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    figures.code += len({token.start[0] for token in tokens if token.type not in skipped} - documented)


def table(figures: Figures, *, tree: bool) -> list[str]:
    """The figures as lines of text."""
    shared = {name: places for name, places in figures.classes.items() if len(places) > 1}
    total = sum(len(places) for places in figures.classes.values())
    lengths = sorted(figures.lengths)
    rows = [
        f"lines {sum(figures.lines.values()):,} in {sum(figures.modules.values())} modules, {figures.code:,} of code",
        f"functions {len(lengths):,}: median {statistics.median(lengths):.0f}, 90 % {lengths[len(lengths) * 9 // 10]}, "
        f"longest {lengths[-1]} lines",
        f"private functions of a module {figures.private:,}, "
        f"{figures.called_once / max(figures.private, 1):.0%} named once elsewhere in it",
        f"comments per 100 lines of code {100 * figures.comments / figures.code:.1f}",
        f"calls with more than {POSITIONAL} positional arguments {len(figures.positional)}",
        f"classes {total}, names that stand for several {len(shared)} ({sum(map(len, shared.values()))} classes)",
        f"imports inside functions {len(figures.inner_imports)}",
        f"most modules in a folder {max(figures.modules.values())}",
    ]
    if tree:
        rows += [
            f"{modules:4d} modules {figures.lines[room]:6,d} lines  {room:32} {figures.sentences.get(room, '')}"
            for room, modules in sorted(figures.modules.items())
        ]
    return rows


@click.command()
@click.option(
    "--root", type=click.Path(exists=True, file_okay=False, path_type=Path), default=Path(), help="A checkout."
)
@click.option("--tree", is_flag=True, help="Folder by folder.")
@click.option("--list", "listed", is_flag=True, help="Every call, class and import that is counted, by its place.")
def main(root: Path, tree: bool, listed: bool) -> None:
    """The figures of a checkout's product code."""
    figures = measure(root, FLOORS)
    print("\n".join(table(figures, tree=tree)))
    if listed:
        for place in figures.positional:
            print(f"{place}: more than {POSITIONAL} positional arguments")
        for name, places in sorted(figures.classes.items()):
            if len(places) > 1:
                print(f"class {name}: {', '.join(places)}")
        for place in figures.inner_imports:
            print(f"{place}: import inside a function")


if __name__ == "__main__":
    main()
