"""The report's blocks as a PDF file, A4 across, with a page number and the data's hash on every page."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.commission.acceptance.blocks import Block, Heading, ReportTable, Text

if TYPE_CHECKING:
    from fpdf import FPDF


_FILL = {"good": (227, 243, 230), "bad": (251, 224, 222), "open": (253, 241, 211)}
_HEAD, _PLAIN = (238, 242, 245), (255, 255, 255)
_BLUE = (39, 80, 111)
_FONT, _MONO = "DejaVu", "DejaVuMono"
_SMALL, _BODY = 7.5, 9.5
_HEADING = {1: 17.0, 2: 12.0, 3: 10.0}


def paper(blocks: Sequence[Block], title: str, footer: str, moment: float) -> bytes:
    """The PDF file's bytes. `footer` stands on every page, `moment` (s UTC) is its date of creation."""
    sheet = _sheet(title, footer, moment)
    for block in blocks:
        if isinstance(block, Heading):
            sheet.ln(1 if block.level == 1 else 4)
            if sheet.will_page_break(24):  # a heading does not stand alone at the foot of a page
                sheet.add_page()
            sheet.set_font(_FONT, "B", _HEADING[block.level])
            sheet.set_text_color(*_BLUE)
            sheet.multi_cell(0, None, block.text, new_x="LMARGIN", new_y="NEXT")
            sheet.set_text_color(0)
            sheet.ln(1.5)
        elif isinstance(block, Text):
            sheet.set_font(_FONT, "B" if block.state else "", _BODY)
            if block.state:
                sheet.set_fill_color(*_FILL[block.state])
            sheet.multi_cell(0, 5.5, block.text, fill=bool(block.state), new_x="LMARGIN", new_y="NEXT", align="L")
            sheet.ln(1)
        elif isinstance(block, ReportTable):
            _grid(sheet, block)
        else:
            if sheet.will_page_break(28):  # the lines to sign on stay together
                sheet.add_page()
            sheet.ln(18)
            sheet.set_font(_FONT, size=8.5)
            width = sheet.epw / len(block.roles)
            top = sheet.get_y()
            for index, role in enumerate(block.roles):
                left = sheet.l_margin + index * width
                sheet.line(left, top, left + width - 14, top)
                sheet.set_xy(left, top + 1)
                sheet.cell(width - 14, 5, f"{role}: name, date, signature")
            sheet.set_xy(
                sheet.l_margin, top + 8
            )  # a cell leaves the position beside it, and the next block lay over it
    return bytes(sheet.output())


def _sheet(title: str, footer: str, moment: float) -> FPDF:
    from fpdf import FPDF
    from matplotlib import get_data_path

    class ReportPdf(FPDF):
        def footer(self) -> None:
            self.set_y(-11)
            self.set_font(_FONT, size=6.5)
            self.set_text_color(90)
            self.cell(0, 5, f"{footer}    page {self.page_no()} of {{nb}}", align="C")
            self.set_text_color(0)

    sheet = ReportPdf(orientation="landscape", format="A4")
    # matplotlib brings fonts with the letters of all Latin, Greek and Cyrillic names; those of PDF itself are Latin-1.
    fonts = Path(get_data_path()) / "fonts" / "ttf"
    sheet.add_font(_FONT, "", fonts / "DejaVuSans.ttf")
    sheet.add_font(_FONT, "B", fonts / "DejaVuSans-Bold.ttf")
    sheet.add_font(_MONO, "", fonts / "DejaVuSansMono.ttf")
    sheet.set_title(title)
    sheet.set_creation_date(datetime.fromtimestamp(moment, UTC))
    sheet.set_auto_page_break(True, margin=15)
    sheet.set_margins(14, 12, 14)
    sheet.set_draw_color(190)
    sheet.add_page()
    return sheet


def _grid(sheet: FPDF, block: ReportTable) -> None:
    from fpdf.fonts import FontFace

    sheet.set_font(_FONT, size=_SMALL)
    widths = block.widths or tuple(1.0 for _ in block.columns)
    head = FontFace(emphasis="BOLD", fill_color=_HEAD)
    with sheet.table(
        col_widths=widths, text_align="LEFT", line_height=4.1, headings_style=head, padding=(0.4, 0.8)
    ) as grid:
        row = grid.row()
        for column in block.columns:
            row.cell(column)
        for index, cells in enumerate(block.rows):
            state = block.states[index] if block.states else ""
            fill = _FILL.get(state, _PLAIN)
            row = grid.row()
            for place, cell in enumerate(cells):
                family = _MONO if place in block.mono else None
                row.cell(cell, style=FontFace(family=family, fill_color=fill))
    sheet.ln(2)
