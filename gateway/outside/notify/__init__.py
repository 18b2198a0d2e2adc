"""Telling people of alarms: by mail and web hook, again until it is delivered, and the next one if nobody answers."""

from gateway.outside.notify.messages import AlarmMessage
from gateway.outside.notify.notifier import Notifier, attach_machine
from gateway.outside.notify.senders import RefusedError, UndeliveredError, mail_text, make_senders
