"""Closing the circle: near-twins that a record does not part, the experiment that is proposed, and what it parts."""
