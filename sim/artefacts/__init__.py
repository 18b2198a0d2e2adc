"""A model on disk: one JSON form, a directory, a store of versions."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.artefacts.effect_lines import effect_line_in, effect_line_part, effect_lines_text, read_effect_lines
    from sim.artefacts.familiarity_file import FAMILIARITY_FILE, Familiarity, read_familiarity
    from sim.artefacts.finding_file import FINDING_FILE, DiagnosisFinding, FoundEffect, read_finding
    from sim.artefacts.model_directory import MANIFEST, MODEL_FILE, listed, sha256
    from sim.artefacts.model_json import model_hash, model_text
    from sim.artefacts.store import (
        STORE_FILE,
        VERSIONS,
        Force,
        check_store,
        current,
        forced,
        is_store,
        load,
        locked,
        number_of,
        objection,
        objections,
        promote,
        promotion,
        ran,
        read_model,
        version_directory,
        versions,
    )
    from sim.artefacts.verdict_file import (
        FORECAST,
        UNJUDGED,
        VERDICT_FILE,
        JudgedCriterion,
        ModelVerdict,
        Word,
        read_verdict,
        word_of,
    )
else:
    __getattr__ = opened_at_use(__name__)
