"""What may stand in the plant file and in a device file, checked whole before anything starts."""

from gateway.settings.alarm_kinds import ALARM_KINDS, AlarmKind, settings_of, suppressing
from gateway.settings.changes import changed_machines
from gateway.settings.config import (
    LEAST_BLOCKS,
    MAX_ARMED_MINUTES,
    Config,
    EnsembleSection,
    ForecastSection,
    HistorianSection,
    LogSection,
    ModelSection,
    PageSection,
    WritebackSection,
    configs_from_json,
    configs_to_json,
    load_config,
    load_plant,
)
from gateway.settings.devices import BLOCK_FIELDS, DeviceMap, WritebackLayout, load_device
from gateway.settings.links import DeviceLink
from gateway.settings.northbound import (
    InfluxRow,
    MetricsSection,
    MqttRow,
    NorthboundSecrets,
    NorthboundSection,
    PostgresRow,
    load_northbound_secrets,
)
from gateway.settings.notify import (
    FROM_SECRETS,
    NotifySecrets,
    NotifySection,
    RecipientRow,
    SmtpSection,
    load_secrets,
)

__all__ = [
    "ALARM_KINDS",
    "BLOCK_FIELDS",
    "FROM_SECRETS",
    "LEAST_BLOCKS",
    "MAX_ARMED_MINUTES",
    "AlarmKind",
    "Config",
    "DeviceLink",
    "DeviceMap",
    "EnsembleSection",
    "ForecastSection",
    "HistorianSection",
    "InfluxRow",
    "LogSection",
    "MetricsSection",
    "ModelSection",
    "MqttRow",
    "NorthboundSecrets",
    "NorthboundSection",
    "NotifySecrets",
    "NotifySection",
    "PageSection",
    "PostgresRow",
    "RecipientRow",
    "SmtpSection",
    "WritebackLayout",
    "WritebackSection",
    "changed_machines",
    "configs_from_json",
    "configs_to_json",
    "load_config",
    "load_device",
    "load_northbound_secrets",
    "load_plant",
    "load_secrets",
    "settings_of",
    "suppressing",
]
