"""Guessing how a value lies in registers from what the HMI shows."""
