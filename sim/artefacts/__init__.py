"""A model on disk: one JSON form, a directory, a store of versions."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.artefacts.effect_lines import effect_line_part, effect_lines_text, read_effect_lines, read_embedded_line
    from sim.artefacts.familiarity_file import FAMILIARITY_FILE, Familiarity, read_familiarity
    from sim.artefacts.finding_file import FINDING_FILE, DiagnosisFinding, FoundEffect, read_finding
    from sim.artefacts.model_directory import MANIFEST, MODEL_FILE, read_hashes, sha256
    from sim.artefacts.model_json import model_hash, model_text
    from sim.artefacts.store import (
        STORE_FILE,
        VERSIONS_FOLDER,
        Force,
        check_store,
        current,
        find_force,
        is_store,
        load,
        lock_store,
        objection,
        objections,
        promote,
        promotion,
        ran,
        read_model,
        version_directory,
        version_number,
        versions,
    )
    from sim.artefacts.verdict_file import (
        FORECAST_CRITERION,
        NO_VERDICT_TEXT,
        VERDICT_FILE,
        ForeseenHorizon,
        ForeseenUnit,
        JudgedCriterion,
        ModelVerdict,
        Word,
        rate_criteria,
        read_verdict,
    )
    from sim.artefacts.verdict_pair import HorizonPair, compare_verdicts, pair_horizons
else:
    __getattr__ = lazy_getattr(__name__)
