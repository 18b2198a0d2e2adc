"""What of `docs/alarms.md` is made from the tables: `python -m tests.rig.alarm_page` writes it anew."""

from pathlib import Path

from gateway.machine.alarms import diagram, state_table, transition_table
from gateway.settings import ALARM_KINDS

DOCS = Path(__file__).parents[2] / "docs"
PAGE, PICTURE = DOCS / "alarms.md", DOCS / "alarm_states.svg"


def kind_table() -> str:
    """Every kind of alarm with its defaults, in Markdown."""
    lines = [
        "| alarm | of | priority | bit | what it watches | what to do | otherwise |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, kind in ALARM_KINDS.items():
        about = f"{kind.watches} (NE 107: {kind.namur})" if kind.namur else kind.watches
        response = kind.response.format(tag="the tag", twin="its twin", limit="80", unit="degC")
        bit = "" if kind.bit is None else str(kind.bit)
        lines.append(
            f"| `{name}` | {kind.subject} | {kind.priority} | {bit} | {about} | {response} | {kind.consequence} |"
        )
    return "\n".join(lines)


MADE = {"states": state_table, "transitions": transition_table, "kinds": kind_table}


def made(page: str) -> str:
    """The page with every made part as the tables have it now."""
    for name, make in MADE.items():
        before, begin, rest = page.partition(f"<!-- made: {name} -->\n")
        _, end, after = rest.partition("<!-- end -->")
        page = f"{before}{begin}{make()}\n{end}{after}"
    return page


def main() -> None:
    """Write the page and its picture."""
    PAGE.write_text(made(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    PICTURE.write_text(diagram(), encoding="utf-8")


if __name__ == "__main__":
    main()
