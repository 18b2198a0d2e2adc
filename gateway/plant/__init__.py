"""The gateway as a process: started, supervised, asked, logged, stopped."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.plant.allocator import keep_freed_memory
    from gateway.plant.app import serve
    from gateway.plant.configurations import (
        FOLDER,
        KeptConfiguration,
        configuration_files,
        differences,
        history_folder,
        keep_files,
        kept_configurations,
        require_named_places,
        without_arming,
    )
    from gateway.plant.log import open_log
    from gateway.plant.plant_check import PlantFinding, check_common, check_machine, check_plant
else:
    __getattr__ = lazy_getattr(__name__)
