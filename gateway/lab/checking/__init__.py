"""Models checked, proven and run."""
