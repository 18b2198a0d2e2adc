"""What the gateway has read, served to peers beside it as a read-only Modbus TCP server of its own."""

from gateway.outside.serving.image import DeviceImage, served_rows
from gateway.outside.serving.server import PeerServer
