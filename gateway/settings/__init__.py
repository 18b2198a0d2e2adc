"""What may stand in the plant file and in a device file, checked whole before anything starts."""

from gateway.settings.alarm_kinds import (
    ALARM_KINDS,
    FAULT,
    LEAST_URGENT,
    OF_PLANT,
    PLANT,
    AlarmKind,
    AlarmPlace,
    MachineSigns,
    alarm_subject,
    kind_of,
    settings_of,
    suppressing,
)
from gateway.settings.changes import changed_machines
from gateway.settings.config import (
    LEAST_BLOCKS,
    MAX_ARMED_MINUTES,
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
