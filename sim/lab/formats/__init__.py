"""Models by their names and in their folders: found in whatever form they have, and written."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.formats.find import FoundModel, artefact_base, find_model
    from sim.lab.formats.write_model import check_free, save, write_model_directory
else:
    __getattr__ = lazy_getattr(__name__)
