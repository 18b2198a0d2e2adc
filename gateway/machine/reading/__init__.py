"""How readings come in and what each is worth: the clock, the scan, several links, quality."""

from gateway.machine.reading.clock import Clock, PlantClock, plant_clock
from gateway.machine.reading.link_health import LinkHealth
from gateway.machine.reading.quality import STALE_PERIODS, QualityRules, unread
from gateway.machine.reading.redundant import RedundancyRules, Redundant, RedundantPath, SwitchOver
from gateway.machine.reading.scan import Scan, scans
