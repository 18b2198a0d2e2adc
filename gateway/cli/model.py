"""`decanter model`: the model laboratory, one module a command."""

import click

from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "learn": ("gateway.lab.learn:learn", "Learn a model from traces and write its directory."),
    "show": ("gateway.lab.show:show", "Show a model and where it comes from."),
    "simulate": ("gateway.lab.simulate:simulate", "Let a model run along measured traces; say how far off it is."),
    "check": ("gateway.lab.check:check", "Answer a query: how probable, how hot, whether it can."),
    "correct": ("gateway.lab.correct:correct", "Learn T' = k T + b from traces and write the corrected model."),
    "skill": (
        "gateway.lab.skill:skill",
        "Forecast along held-out traces as the running gateway does; score it beside rivals.",
    ),
    "validate": (
        "gateway.lab.validate:validate",
        "Validate models along measured traces in nine stages; write a report for each.",
    ),
    "prove": ("gateway.lab.prove:prove", "Prove or refute what a model can do; say whether it may be deployed."),
    "promote": ("gateway.lab.promote:promote", "Make a version of a store current, if its model verifies."),
    "rank": ("gateway.lab.rank:rank", "Compare models on the same traces; say which are fit for deployment."),
    "tune": ("gateway.lab.tune:tune", "Search a learning method's best settings by cross-validation over traces."),
    "export": ("gateway.lab.export:export", "Write a model for UPPAAL along traces; compare with its engine."),
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    renamed={"verify": "`decanter model prove` (`decanter plc verify` compares tags with the HMI)"},
    short_help="The model laboratory: learn, validate, check and export models.",
)
def model() -> None:
    """Learn, look at, validate and check models."""
