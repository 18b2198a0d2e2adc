"""What may stand in the plant file and in a device file, checked whole before anything starts."""
