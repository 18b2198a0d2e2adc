"""Guessing how a value lies in registers from what the HMI shows."""

from gateway.commission.encodings.advice import advise
from gateway.commission.encodings.reading import ReadingError, ShownNumber, parse_display
from gateway.commission.encodings.scoring import Observation, rank
