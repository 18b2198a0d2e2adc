"""What may stand in the plant file and in a device file, checked whole before anything starts."""

from gateway.settings.alarm_kinds import (
    ALARM_KINDS,
    ANOMALY_FLOOR,
    FAULT_THRESHOLD,
    LEAST_URGENT,
    OF_PLANT,
    PLANT,
    AlarmKind,
    AlarmPlace,
    MachineSigns,
    alarm_subject,
    merge_settings,
    parse_kind,
    parse_suppression,
)
from gateway.settings.changes import changed_machines
from gateway.settings.config import (
    MAX_ARMED_MINUTES,
    MIN_BLOCKS_PER_SECOND,
    PAGE_SUBJECT,
    AlarmSection,
    Config,
    EnsembleSection,
    ForecastSection,
    HistorianSection,
    LogSection,
    ModelSection,
    PageSection,
    WritebackSection,
    is_common,
    load_config,
    load_plant,
    read_plant,
)
from gateway.settings.devices import BLOCK_FIELDS, DeviceMap, WritebackLayout, load_device
from gateway.settings.links import DeviceLink
from gateway.settings.northbound import (
    InfluxRow,
    MetricsSection,
    MqttRow,
    NorthboundSecrets,
    NorthboundSection,
    OpcUaSection,
    PostgresRow,
    SinkKind,
    SinkRow,
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
from gateway.settings.places import GatewayPlaces, gateway_places, named_files
