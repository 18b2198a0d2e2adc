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
from gateway.console.output import Progress, emit, make_folder, progress, table
from gateway.console.places import (
    SERVICE_FOLDER,
    SERVICE_LOG,
    SERVICE_RECORDS,
    config_dir,
    find_plant_file,
    plant_here,
    service_of,
    shipped,
)
from gateway.console.result import CommandResult, Line, Part, Rows, View, conclude

__all__ = [
    "SERVICE_FOLDER",
    "SERVICE_LOG",
    "SERVICE_RECORDS",
    "CommandResult",
    "Line",
    "Part",
    "Progress",
    "Rows",
    "View",
    "conclude",
    "config_dir",
    "emit",
    "find_plant_file",
    "finite",
    "historian_machine_option",
    "json_option",
    "make_folder",
    "map_option",
    "plant_here",
    "progress",
    "renamed_option",
    "seed_option",
    "service_of",
    "shipped",
    "socket_option",
    "table",
]
