"""What a running gateway says of itself: the picture, how well that is, what changed in it, and who asks for it.

It needs neither numpy nor a model, so that a command that only looks begins at once.
"""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.outside.status.changes import (
        SAID_BY_CHANGES,
        ChangeLines,
        arming_text,
        clock_text,
        date_text,
        model_text,
        opening_lines,
    )
    from gateway.outside.status.client import ControlError, GatewayLine, connect, short
    from gateway.outside.status.health import (
        HealthFinding,
        findings,
        judge_health,
        link_sentence,
        records_sentence,
        unfamiliar_sentence,
        virtual_sentence,
    )
    from gateway.outside.status.health_words import Health
    from gateway.outside.status.picture import (
        AlarmStatus,
        FamiliarityStatus,
        ForecastStatus,
        GatewayStatus,
        HistorianStatus,
        LinkStatus,
        ModelStatus,
        PastStatus,
        PredictionStatus,
        ScanStatus,
        StatusError,
        StrangeStatus,
        TagStatus,
        TemperatureStatus,
        VirtualStatus,
        read_status,
    )
    from gateway.outside.status.watch import GatewayWatch, Sighting
else:
    __getattr__ = lazy_getattr(__name__)
