"""Traces from somebody's CSV: columns, clocks, cells, and an account of every row."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.traces.auto_thresholds import Levels, levels_of, round_to, with_thresholds
    from sim.traces.cells import SWITCH_WORDS, booleans, numbers
    from sim.traces.channel_use import ChannelUse, channel_uses
    from sim.traces.clock import read_clock
    from sim.traces.column_map import ClockColumns, ColumnMap, load_map, parse_map
    from sim.traces.cycles import split_cycles
    from sim.traces.load_report import LoadReport, TraceError, listed
    from sim.traces.readings import unread_hash
    from sim.traces.text_table import SEPARATORS, decode_head
    from sim.traces.trace_file import write_trace
    from sim.traces.traces import files_by_machine, load_traces, units
else:
    __getattr__ = opened_at_use(__name__)

__all__ = [
    "SEPARATORS",
    "SWITCH_WORDS",
    "ChannelUse",
    "ClockColumns",
    "ColumnMap",
    "Levels",
    "LoadReport",
    "TraceError",
    "booleans",
    "channel_uses",
    "decode_head",
    "files_by_machine",
    "levels_of",
    "listed",
    "load_map",
    "load_traces",
    "numbers",
    "parse_map",
    "read_clock",
    "round_to",
    "split_cycles",
    "units",
    "unread_hash",
    "with_thresholds",
    "write_trace",
]
