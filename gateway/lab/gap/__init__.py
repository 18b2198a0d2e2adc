"""Where a model and measured data disagree, and why."""
