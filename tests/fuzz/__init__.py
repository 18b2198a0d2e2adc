"""Fuzz targets for every parser and protocol side: a table of targets, mutations of valid examples, one oracle."""
