"""Pages of reports: anybody's names are text in them, and what runs or fetches is refused by the page itself."""

import re
from pathlib import Path

import pytest

from sim.lab.pages import page_environment

ROOT = Path(__file__).parents[2]
TEMPLATES = [
    path
    for room in ("sim", "gateway/commission/acceptance", "gateway/lab")
    for path in (ROOT / room).rglob("templates/*.html*")
]
MARKUP = '"><script>run()</script><img src=x onerror="run()">{{ 7 * 7 }}'


def test_every_report_is_in_the_one_page_that_lets_nothing_run_or_be_fetched() -> None:
    assert len(TEMPLATES) >= 6
    for path in TEMPLATES:
        text = path.read_text(encoding="utf-8")
        assert path.name == "page.html" or "<html" not in text, f"{path} is a page of its own, without the policy"
        assert not re.search(r"<script|<iframe|<object|<link|\son\w+=|javascript:|url\(", text, re.I), path
        assert set(re.findall(r'<img[^>]* src="([^"]*)"', text)) <= {
            f"{{{{ {name} }}}}" for name in ("missing", "where", "errors", "cycles", "one.data")
        }, path
    page = page_environment("sim.lab").from_string('{% extends "page.html" %}').render()
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'" and rules["img-src"] == "data:" and "script-src" not in rules
    # What stands before it is no name of anybody.
    assert "{{" not in (ROOT / "sim/lab/templates/page.html").read_text(encoding="utf-8").partition("http-equiv")[0]
    assert page.index("http-equiv") < page.index("<title>")


@pytest.mark.parametrize(
    "place", ["<td>{{ name }}</td>", '<p title="{{ name }}">', "{% block title %}{{ name }}{% endblock %}"]
)
def test_names_are_text_wherever_a_template_puts_them(place: str) -> None:
    made = page_environment("sim.lab").from_string(place).render(name=MARKUP)
    assert "<script" not in made and "<img" not in made and '"><' not in made and "49" not in made
