"""Traces from somebody's CSV: columns, clocks, cells, and an account of every row."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.recordings.auto_thresholds import Levels, find_levels, round_value, with_levels, with_thresholds
    from sim.lab.recordings.cells import (
        NO_VALUES,
        RUN_WORDS,
        SWITCH_WORDS,
        Points,
        bare_cells,
        booleans,
        decimal_mark,
        is_lone_point,
        numbers,
        parse_quantity,
        rewrite_points,
    )
    from sim.lab.recordings.channel_use import channel_uses
    from sim.lab.recordings.clock import (
        ELAPSED_MINUTES,
        elapsed_seconds,
        join_days,
        longest_rising_rows,
        read_clock,
        spoken_seconds,
        to_utc,
        unroll_midnight,
    )
    from sim.lab.recordings.clock_counts import COUNTS, dated_format, since_1970
    from sim.lab.recordings.clock_formats import (
        Order,
        is_time,
        pure_date,
        pure_time,
        tells_time,
        time_formats,
        whole_day,
    )
    from sim.lab.recordings.clock_words import plain_time, wall_zone
    from sim.lab.recordings.column_map import (
        ClockColumns,
        ColumnMap,
        load_map,
        parse_map,
        zone_problem,
    )
    from sim.lab.recordings.cycles import split_cycles
    from sim.lab.recordings.fault_codes import find_codes
    from sim.lab.recordings.load_report import LoadReport, TraceError, list_names
    from sim.lab.recordings.readings import join_cells, unread_hash
    from sim.lab.recordings.sources import named_after, read_head, recording_name
    from sim.lab.recordings.text_encoding import decode_head
    from sim.lab.recordings.text_table import (
        MAX_HEADER_LINE,
        MAX_ROW_LINES,
        SEPARATORS,
        UNNAMED_COLUMN,
        compose_names,
        drop_invisible,
        fold_name,
        number_equal_names,
        rows_mark,
        with_row_names,
    )
    from sim.lab.recordings.trace_file import write_trace
    from sim.lab.recordings.traces import csv_files, files_by_machine, load_traces, units
    from sim.lab.recordings.unit_table import CONVERTED_UNITS, FAHRENHEIT_REST_RANGE, UNITS, conversion, known_unit
else:
    __getattr__ = lazy_getattr(__name__)
