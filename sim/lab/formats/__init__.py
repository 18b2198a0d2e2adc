"""A model's other forms: the public learner's files, found, read, converted, written."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.lab.formats.bundle import Artefacts, file_names, read_artefacts, write_artefacts
    from sim.lab.formats.find import FoundModel, artefact_base, find_model
    from sim.lab.formats.flow_file import FLOW_FILE, read_flow_file
    from sim.lab.formats.from_model import reported_laws, to_artefacts
    from sim.lab.formats.histogram import PRINTED, Histogram, evidence, fit, read_histogram
    from sim.lab.formats.report import Report, read_report
    from sim.lab.formats.suffixes import SUFFIXES
    from sim.lab.formats.write_model import check_free, save, write_model_directory
else:
    __getattr__ = opened_at_use(__name__)

__all__ = [
    "FLOW_FILE",
    "PRINTED",
    "SUFFIXES",
    "Artefacts",
    "FoundModel",
    "Histogram",
    "Report",
    "artefact_base",
    "check_free",
    "evidence",
    "file_names",
    "find_model",
    "fit",
    "read_artefacts",
    "read_flow_file",
    "read_histogram",
    "read_report",
    "reported_laws",
    "save",
    "to_artefacts",
    "write_artefacts",
    "write_model_directory",
]
