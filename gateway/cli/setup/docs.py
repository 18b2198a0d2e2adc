"""`decanter docs`: the documentation that this version came with, and the files that its pages use; offline."""

import shutil
from pathlib import Path

import click

from drivers.errors import did_you_mean
from gateway.console import CommandResult, LongText, conclude, config_dir, json_option, make_folder
from gateway.entry import sentences


def docs_dir() -> Path:
    """The folder of the pages: `docs` of a checkout, or its copy inside an installed package."""
    packaged = Path(__file__).parents[2] / "_docs"
    return packaged if packaged.is_dir() else Path(__file__).parents[3] / "docs"


@click.command(short_help="Print a page of the documentation, or the list of pages.")
@click.argument("page", required=False)
@click.option(
    "--examples",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Copy the files that the pages use into this folder, which is made.",
)
@json_option
def docs(page: str | None, examples: Path | None, as_json: bool) -> None:
    """Print PAGE of the documentation, such as `tutorial`, or a record of a decision by its number; else list them."""
    with sentences():
        if examples is not None:
            copied = _copy_examples(examples)
            conclude(CommandResult({"examples": copied}), lambda _: ["\n".join(copied)], as_json=as_json)
        elif page is not None:
            name = _page(page)
            text = (docs_dir() / f"{name}.md").read_text(encoding="utf-8")
            conclude(CommandResult({"page": name, "text": text}), lambda _: [LongText(text)], as_json=as_json)
        else:
            titles = {name: _title(name) for name in sorted(_names()) if "/" not in name and name != "index"}
            width = max(map(len, titles))
            lines = [f"{name:{width}}  {title}" for name, title in titles.items()]
            lines.append("\ndecanter docs PAGE prints one, decanter docs 0001 a decision; decisions/index lists these")
            conclude(CommandResult({"pages": titles}), lambda _: ["\n".join(lines)], as_json=as_json)


def _names() -> list[str]:
    """The pages by their path in the folder, without the ending."""
    return [path.relative_to(docs_dir()).with_suffix("").as_posix() for path in docs_dir().rglob("*.md")]


def _title(name: str) -> str:
    with (docs_dir() / f"{name}.md").open(encoding="utf-8") as lines:
        return next(lines).lstrip("# ").strip()


def _page(wanted: str) -> str:
    """The page that is meant. Raises ValueError for one that is not there."""
    names = _names()
    asked = wanted.removesuffix(".md").removeprefix("docs/").lower()
    if asked in names:
        return asked
    numbered = [name for name in names if asked.isdecimal() and name.startswith(f"decisions/{int(asked):04d}-")]
    if numbered:
        return numbered[0]
    pages = [name for name in names if "/" not in name]
    remedy = did_you_mean(asked, pages) or f"give one of {', '.join(sorted(pages))}"
    raise ValueError(f"{wanted!r}: there is no such page; {remedy}")


def _copy_examples(folder: Path) -> list[str]:
    """Copy config/examples; gives the new files. Raises ValueError where one is there, before any is written."""
    sources = sorted((config_dir() / "examples").iterdir())
    targets = [folder / source.name for source in sources]
    if there := [str(path) for path in targets if path.exists()]:
        raise ValueError(f"{', '.join(there)}: is there already; give another folder")
    make_folder(folder)
    for source, target in zip(sources, targets, strict=True):
        shutil.copyfile(source, target)
    return list(map(str, targets))
