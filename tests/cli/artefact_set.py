"""A small set of artefacts in the public learner's form, which can be run along decanter traces."""

from pathlib import Path

SOURCE = """digraph hybrid_automaton {{
\tedge [arrowsize=0.5]
\tnode [shape=circle]
{nodes}\t__init__ [label=<<FONT  POINT-SIZE="8" COLOR="black">__init__</FONT>>]
{edges}}}
"""
NODE = (
    '\tq_{0} [label=<<FONT  POINT-SIZE="8" COLOR="black">q_{0}</FONT><br/>'
    '<FONT  POINT-SIZE="6" COLOR="#ad0c00"><br/><b>f_{0}, D_{0}</b></FONT>>]\n'
)
EDGE = '\t{0} -> {2} [label=<<FONT  POINT-SIZE="8" COLOR="#0067b0">{1}</FONT>>]\n'
EDGES = [
    ("__init__", "W_OFF", "q_0"),
    ("__init__", "W_ON", "q_1"),
    ("q_0", "W_ON", "q_1"),
    ("q_1", "W_OFF", "q_0"),
    *((place, f"A_{level}", place) for place in ("q_0", "q_1") for level in range(4)),
]
REPORT = """--OBSERVABLE EVENTS--

W_ON: MarciaDecanter 0->1
W_OFF: MarciaDecanter 1->0


--LEARNED DISTRIBUTIONS--

D_0(0.001000)
D_1(0.002000)


--FINAL OBSERVATION TABLE--

--PERFORMANCE DATA--
"""
HISTOGRAM = "D_0:\n0.0009\n0.0011\nD_1:\n0.0015\n0.0025\n"
FLOWS = "0\n(x0)' = -0.001 (x0 - 15)\n1\n(x0)' = -0.002 (x0 - 45)\n"
THESIS = """Location 0: mu=20.5, sigma=3.0, flow=linear(alpha=-0.001)
Location 1: mu=26.5, sigma=3.0, flow=linear(alpha=0.005)
"""


def source(edges: list[tuple[str, str, str]]) -> str:
    """The DOT text of two locations, q_0 and q_1, with these edges (source, symbol, target)."""
    return SOURCE.format(nodes=NODE.format(0) + NODE.format(1), edges="".join(EDGE.format(*edge) for edge in edges))


def files(name: str = "SMALL") -> dict[str, str]:
    """The four files by their names."""
    return {
        f"{name}_source.txt": source(EDGES),
        f"{name}.txt": REPORT,
        f"{name}_histogram_values.txt": HISTOGRAM,
        "flow_conditions.txt": FLOWS,
    }


def written(folder: Path, content: dict[str, str]) -> Path:
    """Write them; returns DIR/NAME."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in content.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "SMALL"
