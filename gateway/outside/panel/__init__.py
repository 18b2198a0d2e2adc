"""The live panel of a running gateway: its rows, the whole of it, and following a gateway with it."""

from gateway.outside.panel.draw import frame_rows, number, panel, status_rows
from gateway.outside.panel.following import follow
