"""A diagnosis written: document, report, pictures, the folder that holds them."""

from sim.lab.discrepancy.output.diagnosis_json import MISSING_HEAT_FILE, document
from sim.lab.discrepancy.output.folder import MODEL, check_folder, write_diagnosis
from sim.lab.discrepancy.output.report import Occasion
