"""Models as UPPAAL text, and what its engine answers."""

from sim.lab.uppaal.comparison import compare, native_runs
from sim.lab.uppaal.model_export import base_name, export, write
from sim.lab.uppaal.verifyta import EngineError, find_engine, run_engine
