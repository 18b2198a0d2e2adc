"""Traces from somebody's CSV: columns, clocks, cells, and an account of every row."""

from sim.traces.channel_use import ChannelUse, channel_uses
from sim.traces.column_map import ColumnMap, load_map
from sim.traces.cycles import split_cycles
from sim.traces.load_report import LoadReport, listed
from sim.traces.trace_file import write_trace
from sim.traces.traces import load_traces, units

__all__ = [
    "ChannelUse",
    "ColumnMap",
    "LoadReport",
    "channel_uses",
    "listed",
    "load_map",
    "load_traces",
    "split_cycles",
    "units",
    "write_trace",
]
