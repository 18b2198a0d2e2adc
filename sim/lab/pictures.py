"""How pictures are written to files: the endings that there are, and one way to save a figure."""

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


def save_picture(figure: Figure, target: Path | StringIO, form: str) -> None:
    """Write a figure in the form `png`, `pdf` or `svg`. Raises OSError."""
    with writing(target if isinstance(target, Path) else "the picture"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a letter that the font lacks is shown as a box
        figure.savefig(target, format=form, dpi=110, metadata={"Date": None} if form == "svg" else None)
