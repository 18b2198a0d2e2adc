"""A diagnosis written: document, report, pictures, the folder that holds them."""

from sim.discrepancy.output.diagnosis_json import document
from sim.discrepancy.output.folder import MODEL, check_folder, write_diagnosis
from sim.discrepancy.output.report import Occasion

__all__ = ["MODEL", "Occasion", "check_folder", "document", "write_diagnosis"]
