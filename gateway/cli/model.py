"""`decanter model`: the model laboratory, one module a command."""

import click

from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "learn": ("gateway.lab.learning.commands:learn", "Learn a model from traces and write its directory."),
    "show": ("gateway.lab.models.show:show", "Show a model and where it comes from."),
    "simulate": (
        "gateway.lab.checking.simulate:simulate",
        "Let a model run along measured traces; say how far off it is.",
    ),
    "check": ("gateway.lab.checking.commands:check", "Answer a query: how probable, how hot, whether it can."),
    "correct": (
        "gateway.lab.learning.commands:correct",
        "Learn T' = k T + b from traces and write the corrected model.",
    ),
    "skill": (
        "gateway.lab.judging.commands:skill",
        "Forecast along held-out traces as the running gateway does; score it beside rivals.",
    ),
    "validate": (
        "gateway.lab.judging.commands:validate",
        "Validate models along measured traces in nine stages; write a report for each.",
    ),
    "prove": (
        "gateway.lab.checking.prove:prove",
        "Prove or refute what a model can do; say whether it may be deployed.",
    ),
    "promote": ("gateway.lab.models.promote:promote", "Make a version of a store current, if its model verifies."),
    "rank": (
        "gateway.lab.judging.commands:rank",
        "Compare models on the same traces; say which are fit for deployment.",
    ),
    "tune": (
        "gateway.lab.learning.commands:tune",
        "Search a learning method's best settings by cross-validation over traces.",
    ),
    "retrain": (
        "gateway.lab.retraining.commands:retrain_command",
        "Learn from the historian's new cycles; propose a version that is better.",
    ),
    "cycles": (
        "gateway.lab.retraining.commands:cycles_command",
        "List a library's cycles, rated; exclude one with a reason.",
    ),
    "shadow": (
        "gateway.lab.retraining.commands:shadow_command",
        "Compare two versions on live cycles; promote the better one by a stated policy.",
    ),
    "lineage": (
        "gateway.lab.retraining.commands:lineage_command",
        "Draw the family of a store's versions; make one again.",
    ),
    "regress": (
        "gateway.lab.regression.commands:regress",
        "Run a standard set against all models; say what became worse since when.",
    ),
    "fleet": ("gateway.lab.fleet.commands:fleet", "Learn a type's model from many machines; say which stands out."),
    "export": ("gateway.lab.models.commands:export", "Write a model for UPPAAL along traces; compare with its engine."),
}


EXAMPLES = {
    "learn": "model learn --traces out/traces --out out/model",
    "show": "model show out/model",
    "simulate": "model simulate out/model --trace out/traces/cd8.csv --picture simulated.png",
    "check": "model check out/model 'Pr[<=600](<> Temp >= 80)' --events out/traces/cd8.csv",
    "correct": "model correct out/model --traces out/traces --out out/corrected",
    "skill": "model skill out/model --traces out/traces",
    "validate": "model validate out/model --traces out/traces --out out/validation",
    "prove": "model prove out/model --traces out/traces",
    "promote": "model promote models/decanter --add out/model",
    "rank": "model rank out/model out/corrected --traces out/traces",
    "tune": "model tune --traces out/traces --study out/tune.db",
    "retrain": "model retrain models/decanter --historian out/historian.sqlite --standard out/traces",
    "cycles": "model cycles out/cycles/decanter-TCuscinettiRiduttore --rating rare",
    "shadow": "model shadow models/decanter --historian out/historian.sqlite --roll-back",
    "lineage": "model lineage models/decanter",
    "fleet": "model fleet out/machines --out out/fleet",
    "regress": "model regress models/decanter --standard out/traces",
    "export": "model export out/model --uppaal --trace out/traces/cd8.csv --out out/uppaal",
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    examples=EXAMPLES,
    elsewhere={"verify": "`decanter model prove` (`decanter plc verify` compares tags with the HMI)"},
    short_help="The model laboratory.",
)
def model() -> None:
    """Learn, look at, validate and check models."""
