"""The public learner's files: their grammars, a model made of them, and one written as they are; may be left out."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.formats.foreign.bundle import Artefacts, file_names, read_artefacts, texts, write_artefacts
    from sim.lab.formats.foreign.convert import Parameter, structure, to_sha
    from sim.lab.formats.foreign.flow_file import FLOW_FILE, read_flow_file
    from sim.lab.formats.foreign.from_model import RawValues, reported_laws, to_artefacts
    from sim.lab.formats.foreign.histogram import PRINT_TOLERANCE, Histogram, evidence, fit_values, read_histogram
    from sim.lab.formats.foreign.report import Report, read_report
else:
    __getattr__ = lazy_getattr(__name__)
