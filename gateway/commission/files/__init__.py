"""The files that commissioning reads and changes: I/O lists, device files, plant files."""

from gateway.commission.files.cells import ListError, header_key, read_sheet
from gateway.commission.files.change import Binding, BlockPlace, FileChange, apply_change, plant_findings
from gateway.commission.files.device_file import ENCODING
from gateway.commission.files.edit_command import edit_files, template
from gateway.commission.files.first_folder import FirstFolder
from gateway.commission.files.io_list import IoList, Reading, read_io_list
from gateway.commission.files.io_models import MOST_REPEATS
from gateway.commission.files.io_words import COLUMNS, parse_flag
from gateway.commission.files.machines import with_machine, without_machine
from gateway.commission.files.plan_files import Files, find_files, split_settings
from gateway.commission.files.recording import ScanRecorder, SiteRecording, read_recording
from gateway.commission.files.toml_edit import Edit, commit
