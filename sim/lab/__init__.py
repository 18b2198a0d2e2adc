"""The laboratory: recordings, learning, checking, judging and the gap between a model and what was measured."""
