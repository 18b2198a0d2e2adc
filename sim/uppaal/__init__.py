"""Models as UPPAAL text, and what its engine answers."""

from sim.uppaal.comparison import compare, native_runs
from sim.uppaal.model_export import base_name, export, write
from sim.uppaal.verifyta import EngineError, find_engine, run_engine

__all__ = ["EngineError", "base_name", "compare", "export", "find_engine", "native_runs", "run_engine", "write"]
