"""What commands show and take: tables, JSON, progress, options that several share."""

from gateway.console.options import (
    finite,
    historian_machine_option,
    json_option,
    map_option,
    renamed_option,
    seed_option,
    socket_option,
)
from gateway.console.output import Progress, make_folder, progress, table
from gateway.console.places import SERVICE_FOLDER, config_dir, find_plant_file, find_service, shipped_file
from gateway.console.result import CommandResult, Drawing, Line, LongText, Part, Rows, View, conclude
