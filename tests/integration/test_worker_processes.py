"""A plant split over two processes under one supervisor: the same records, status and commands as with one."""

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest

from gateway.store import read, stored_rows, verify
from tests.cli.support import decanter, only_object
from tests.rig.pair import MAP, ROOT, Gateway, Plc, end, plc_process

MACHINES = ("a", "b", "c", "d")
