"""How pictures are made and written: an empty figure without a window, the endings of files, one way to save."""

from __future__ import annotations

import warnings
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.named_files import writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ENDINGS = (".png", ".pdf", ".svg")


def check_picture(path: Path) -> None:
    """Raises ValueError for another ending than those of pictures."""
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: cannot be a picture; give a name that ends in {', '.join(ENDINGS)}")


def blank_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, which no window shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def write_picture(figure: Figure, path: Path) -> Path:
    """Write a figure to a file of its own ending, in a folder that is made if need be. Raises ValueError, OSError."""
    check_picture(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_picture(figure, path, path.suffix[1:].lower())
    return path


def svg_text(figure: Figure) -> str:
    """A figure as it stands inside a page: SVG without the XML prologue, which has no place in HTML."""
    text = StringIO()
    save_picture(figure, text, "svg")
    return "".join(text.getvalue().partition("<svg")[1:])


def save_picture(figure: Figure, target: Path | StringIO, form: str) -> None:
    """Write a figure in the form `png`, `pdf` or `svg`. Raises OSError."""
    with writing(target if isinstance(target, Path) else "the picture"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a letter that the font lacks is shown as a box
        figure.savefig(target, format=form, dpi=110, metadata={"Date": None} if form == "svg" else None)
