"""What the model makes of a scan: prediction, guards, forecast, and a newer model that takes over."""

from gateway.machine.model.along import estimate_offset, forecast_trace, new_readings, recorded_scans
from gateway.machine.model.drift import MIN_CYCLE_READINGS, make_drift_rule
from gateway.machine.model.loading import (
    LoadedModel,
    LoadedModels,
    ModelsAtStart,
    load_model,
    load_models,
    models_at_start,
)
from gateway.machine.model.outlook import FinishedForecast, block_values
from gateway.machine.model.predict import ZONES, ScanPrediction
from gateway.machine.model.unit import ModelUnit
