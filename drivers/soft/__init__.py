"""A device without hardware; opened by its name in `drivers.driver.DRIVERS`."""
