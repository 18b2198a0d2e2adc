"""Telling people of alarms: by mail and web hook, again until it is delivered, and the next one if nobody answers."""

from gateway.outside.notify.messages import AlarmMessage
from gateway.outside.notify.notifier import Delivery, Notifier, attach_machine
from gateway.outside.notify.senders import RefusedError, Sender, UndeliveredError, make_senders

__all__ = [
    "AlarmMessage",
    "Delivery",
    "Notifier",
    "RefusedError",
    "Sender",
    "UndeliveredError",
    "attach_machine",
    "make_senders",
]
