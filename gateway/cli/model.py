"""`decanter model`: the model laboratory, one module a command."""

import click

from gateway.entry import FirstWordCommand, LazyGroup, Table

COMMANDS: Table = {
    "learn": ("gateway.cli.model:learn", "Learn from traces: a model, a correction, settings, a fleet."),
    "show": ("gateway.lab.models.commands:show", "Show a model and where it comes from."),
    "simulate": (
        "gateway.lab.checking.commands:simulate",
        "Let a model run along measured traces; say how far off it is.",
    ),
    "check": ("gateway.lab.checking.commands:check", "Answer a query: how probable, how hot, whether it can."),
    "judge": ("gateway.cli.model:judge", "Say whether a model is fit: proof, skill, validation, rank, regression."),
    "version": ("gateway.cli.model:version", "The versions of a store: retrain, cycles, shadow, promote, lineage."),
    "export": ("gateway.lab.models.commands:export", "Write a model for UPPAAL along traces; compare with its engine."),
}
LEARNED: Table = {
    "model": ("gateway.lab.learning.commands:learn", "Learn a model from traces and write its directory."),
    "correction": (
        "gateway.lab.learning.commands:correct",
        "Learn T' = k T + b from traces and write the corrected model.",
    ),
    "settings": (
        "gateway.lab.learning.commands:tune",
        "Search a learning method's best settings by cross-validation over traces.",
    ),
    "fleet": ("gateway.lab.fleet.commands:fleet", "Learn a type's model from many machines; say which stands out."),
}
LEARN_EXAMPLES = {
    "model": "model learn model --traces out/traces --out out/model",
    "correction": "model learn correction out/model --traces out/traces --out out/corrected",
    "settings": "model learn settings --traces out/traces --study out/tune.db",
    "fleet": "model learn fleet out/machines --out out/fleet",
}
learn = FirstWordCommand(
    "learn",
    table=LEARNED,
    examples=LEARN_EXAMPLES,
    usual="model",
    short_help="Learn from traces: a model, a correction, settings, a fleet.",
    help="Learn a model from traces, correct one, search the best settings, or learn from many machines at once.",
)
JUDGED: Table = {
    "proof": (
        "gateway.lab.checking.commands:prove",
        "Prove or refute what a model can do; say whether it may be deployed.",
    ),
    "skill": (
        "gateway.lab.judging.commands:skill",
        "Forecast along held-out traces as the running gateway does; score it beside rivals.",
    ),
    "validation": (
        "gateway.lab.judging.commands:validate",
        "Validate models along measured traces in nine stages; write a report for each.",
    ),
    "rank": (
        "gateway.lab.judging.commands:rank",
        "Compare models on the same traces; say which are fit for deployment.",
    ),
    "regression": (
        "gateway.lab.regression.commands:regress",
        "Run a standard set against all models; say what became worse since when.",
    ),
}
JUDGE_EXAMPLES = {
    "proof": "model judge proof out/model --traces out/traces",
    "skill": "model judge skill out/model --traces out/traces",
    "validation": "model judge validation out/model --traces out/traces --out out/validation",
    "rank": "model judge rank out/model out/corrected --traces out/traces",
    "regression": "model judge regression models/decanter --standard out/traces",
}
judge = FirstWordCommand(
    "judge",
    table=JUDGED,
    examples=JUDGE_EXAMPLES,
    usual="proof",
    short_help="Say whether a model is fit: proof, skill, validation, rank, regression.",
    help="Say whether a model is fit, and why: by proof, by its forecasts, against others and against its past.",
)
VERSIONED: Table = {
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
    "promote": ("gateway.lab.models.commands:promote", "Make a version of a store current, if its model verifies."),
    "lineage": (
        "gateway.lab.retraining.commands:lineage_command",
        "Draw the family of a store's versions; make one again.",
    ),
}
VERSION_EXAMPLES = {
    "retrain": "model version retrain models/decanter --historian out/historian.sqlite --standard out/traces",
    "cycles": "model version cycles out/cycles/decanter-TCuscinettiRiduttore --rating rare",
    "shadow": "model version shadow models/decanter --historian out/historian.sqlite --roll-back",
    "promote": "model version promote models/decanter --add out/model",
    "lineage": "model version lineage models/decanter",
}
version = FirstWordCommand(
    "version",
    table=VERSIONED,
    examples=VERSION_EXAMPLES,
    usual="lineage",
    short_help="The versions of a store: retrain, cycles, shadow, promote, lineage.",
    help="Show a store's versions, learn a better one, hold two against each other, say which one runs.",
)
EXAMPLES = {
    "learn": "model learn --traces out/traces --out out/model",
    "show": "model show out/model",
    "simulate": "model simulate out/model --trace out/traces/cd8.csv --picture simulated.png",
    "check": "model check out/model 'Pr[<=600](<> Temp >= 80)' --events out/traces/cd8.csv",
    "judge": "model judge out/model --traces out/traces",
    "version": "model version models/decanter",
    "export": "model export out/model --uppaal --trace out/traces/cd8.csv --out out/uppaal",
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    examples=EXAMPLES,
    elsewhere={"verify": "`decanter model judge proof` (`decanter plc check hmi` compares tags with the HMI)"},
    short_help="The model laboratory.",
)
def model() -> None:
    """Learn, look at, validate and check models."""
