"""What the model makes of a scan: prediction, guards, forecast, and a newer model that takes over."""

from gateway.machine.model.loading import load_members, load_model
from gateway.machine.model.outlook import FinishedForecast, block_values
from gateway.machine.model.predict import ZONES, ScanPrediction
from gateway.machine.model.unit import ModelUnit

__all__ = ["ZONES", "FinishedForecast", "ModelUnit", "ScanPrediction", "block_values", "load_members", "load_model"]
