"""By what the files of a set of artefacts are told: where one lies is asked of every name that may be a model's."""

from collections.abc import Mapping

SUFFIXES: Mapping[str, str] = {"source": "_source.txt", "report": ".txt", "histogram": "_histogram_values.txt"}
