"""Recordings of one small plant in the forms of many exporters, and what they must give."""
