"""The maps on the measured files: rows counted against the file itself, values against a second reading of it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.sha.trace import joint_hash
from tests.validation.places import DATA, MAPS

pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(not DATA.is_dir(), reason="the measured data (../shared/data) is not here"),
]


def lines(path: Path) -> int:
    return sum(1 for line in path.read_bytes().split(b"\n") if line.strip()) - 1


def test_skab_is_the_motors_temperature_with_its_own_current() -> None:
    path = DATA / "skab" / "anomaly-free.csv"
    (trace,), report = load_traces(path, load_map(MAPS / "skab.toml"))
    raw = pd.read_csv(path, sep=";", parse_dates=["datetime"])
    assert report.used == report.rows == len(raw)
    np.testing.assert_allclose(trace.signals["MotorTemperature"], raw["Temperature"], rtol=1e-12)
    np.testing.assert_allclose(trace.signals["Assorbimento"], raw["Current"], rtol=1e-12)
    np.testing.assert_array_equal(np.diff(trace.times), raw["datetime"].diff().dt.total_seconds()[1:])
    assert [event.symbol for event in trace.events] == ["W_ON", "A_1"]
    assert not trace.synthetic and trace.origin == str(path)


def test_a_femto_bearing_is_read_at_ten_hertz_and_its_vibration_file_is_refused() -> None:
    traces, report = load_traces(DATA / "femto_bearing", load_map(MAPS / "femto.toml"))
    assert [trace.name for trace in traces] == ["Bearing2_4_temp", "Bearing2_5_temp"]
    assert [file.rows for file in report.files if not file.error] == [74447, 231007]
    assert len(report.errors) == 2 and all("there is no column 'x0.1_second'" in error for error in report.errors)
    for trace in traces:
        np.testing.assert_allclose(np.diff(trace.times), 0.1, atol=1e-9)
        raw = pd.read_csv(DATA / "femto_bearing" / f"{trace.name}.csv")
        np.testing.assert_allclose(trace.signals["BearingTemperature"], raw["temperature"], rtol=1e-12)


def test_carobd_drives_load_with_repeated_rows_averaged() -> None:
    traces, report = load_traces(DATA / "carobd", load_map(MAPS / "carobd.toml"))
    assert len(traces) == len(report.files) == 8 and not report.errors
    for trace, file in zip(traces, report.files, strict=True):
        assert file.used == trace.times.size + file.merged
        raw = pd.read_csv(file.path, index_col=False, skipinitialspace=True)
        assert file.rows == len(raw)
        whole = raw.dropna()
        mean = whole.groupby("ENGINE_RUN_TINE ()")["COOLANT_TEMPERATURE ()"].mean()
        np.testing.assert_allclose(trace.signals["CoolantTemperature"], mean, rtol=1e-12)
        np.testing.assert_array_equal(trace.times, mean.index)


def test_the_cnc_cycles_load_although_some_lack_columns() -> None:
    traces, report = load_traces(DATA / "lsha_upstream" / "made_cnc", load_map(MAPS / "made_cnc.toml"))
    assert len(traces) == 15 and report.used == report.rows == sum(lines(file.path) for file in report.files)
    assert all({"l", "i_0"} <= {event.symbol for event in trace.events} for trace in traces)


def test_the_can_log_is_pivoted_and_other_signals_are_set_aside() -> None:
    path = DATA / "can_obd2" / "tripA164_decoded_long.csv"
    (trace,), report = load_traces(path, load_map(MAPS / "can_obd2.toml"))
    raw = pd.read_csv(path)
    coolant = raw[raw["signal"] == "COOLANT_TEMP"]
    column = trace.signals["CoolantTemperature"]
    np.testing.assert_array_equal(column[~np.isnan(column)], coolant["value"])
    np.testing.assert_array_equal(trace.times[~np.isnan(column)], coolant["time_s"])
    assert report.files[0].aside == raw["signal"].isin(["FUEL_LEVEL", "CTRL_MODULE_VOLT", "BARO"]).sum()


def test_the_fingerprint_of_real_traces_does_not_depend_on_the_order_of_files() -> None:
    column_map = load_map(MAPS / "made_cnc.toml")
    files = sorted((DATA / "lsha_upstream" / "made_cnc").glob("*.csv"))
    assert joint_hash(load_traces(files, column_map)[0]) == joint_hash(load_traces(files[::-1], column_map)[0])
