"""Models learned, tuned and corrected."""
