"""What leaves the process: the page, sinks, notifications, served registers, the status and its words."""
