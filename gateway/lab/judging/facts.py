"""What a model at hand says of itself: the gate of verification, and where its traces come from."""

from dataclasses import replace

from sim.lab.validation import Facts, Prepared
from sim.proof import verify
from sim.sha import Model


def gate_of(model: Model) -> tuple[bool, str]:
    """Whether verification lets the model be deployed, and the sentence that says so."""
    verification = verify(model)
    if verification.deployable:
        return (
            True,
            f"verified: {len([check for check in verification.checks if check.blocking])} blocking checks are proven",
        )
    return False, "; ".join(verification.reasons)


def facts_of(prepared: Prepared) -> dict[str, Facts]:
    """What a model at hand says of itself, by semantics; a model that cannot be run fails the gate."""
    facts = {"": Facts(verified=False, gate="; ".join(prepared.refusals.values()))}
    for semantics, model in prepared.variants.items():
        verified, gate = gate_of(model)
        facts[semantics] = replace(origin_of(model), verified=verified, gate=gate)
    return facts


def origin_of(model: Model) -> Facts:
    """Artefacts and models by hand do not say what they were learned from."""
    known = bool(model.provenance.data_hash or model.provenance.traces)
    return Facts(synthetic=model.provenance.synthetic if known else None)
