"""Telling people of alarms: by mail and web hook, again until it is delivered, and the next one if nobody answers."""

from gateway.notify.messages import AlarmMessage
from gateway.notify.notifier import Delivery, Notifier, attach_machine
from gateway.notify.senders import RefusedError, Sender, UndeliveredError, make_senders

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
