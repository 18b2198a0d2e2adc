"""Traces from somebody's CSV: columns, clocks, cells, and an account of every row."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.lab.recordings.auto_thresholds import Levels, driven_by, levels_of, round_to, with_thresholds
    from sim.lab.recordings.cells import RUN_WORDS, SWITCH_WORDS, booleans, decimal_mark, measured, numbers
    from sim.lab.recordings.channel_use import channel_uses
    from sim.lab.recordings.clock import longest_rising, read_clock, to_utc, unroll_midnight
    from sim.lab.recordings.clock_counts import COUNTS, dated_format, since_1970
    from sim.lab.recordings.clock_words import plain_time
    from sim.lab.recordings.column_map import (
        ClockColumns,
        ColumnMap,
        load_map,
        parse_map,
        zone_problem,
    )
    from sim.lab.recordings.cycles import split_cycles
    from sim.lab.recordings.fault_codes import codes_in
    from sim.lab.recordings.load_report import LoadReport, TraceError, listed
    from sim.lab.recordings.readings import unread_hash
    from sim.lab.recordings.sources import head_of, stem_of
    from sim.lab.recordings.text_table import (
        SEPARATORS,
        UNNAMED,
        decode_head,
        folded,
        rows_mark,
        told_apart,
        with_row_names,
    )
    from sim.lab.recordings.trace_file import write_trace
    from sim.lab.recordings.traces import csv_files, files_by_machine, load_traces, units
    from sim.lab.recordings.unit_table import KEPT, UNITS, conversion, known_unit
else:
    __getattr__ = opened_at_use(__name__)
