"""Where a machine stands between its start and its end."""

from typing import Literal

Phase = Literal["starting", "running", "stopping", "stopped"]
