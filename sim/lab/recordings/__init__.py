"""Traces from somebody's CSV: columns, clocks, cells, and an account of every row."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.lab.recordings.auto_thresholds import Levels, levels_of, round_to, with_thresholds
    from sim.lab.recordings.cells import SWITCH_WORDS, booleans, numbers
    from sim.lab.recordings.channel_use import channel_uses
    from sim.lab.recordings.clock import read_clock
    from sim.lab.recordings.column_map import ClockColumns, ColumnMap, load_map, parse_map
    from sim.lab.recordings.cycles import split_cycles
    from sim.lab.recordings.load_report import LoadReport, TraceError, listed
    from sim.lab.recordings.readings import unread_hash
    from sim.lab.recordings.text_table import SEPARATORS, decode_head
    from sim.lab.recordings.trace_file import write_trace
    from sim.lab.recordings.traces import files_by_machine, load_traces, units
else:
    __getattr__ = opened_at_use(__name__)
