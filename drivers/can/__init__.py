"""Raw CAN: any python-can interface, signals by DBC or by plain bit fields, and a bus between processes."""
