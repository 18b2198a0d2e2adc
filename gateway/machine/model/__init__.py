"""What the model makes of a scan: prediction, guards, forecast, and a newer model that takes over."""
