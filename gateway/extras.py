"""What not every installation has, and by which package it comes: the one owner of the sentence that says so."""

from collections.abc import Mapping

from drivers.errors import missing_part

DEBIAN_PACKAGES: Mapping[str, str] = {
    "mqtt": "decanter-gateway",
    "opcua": "decanter-gateway",
    "postgres": "decanter-gateway",
    "prometheus": "decanter-gateway",
    "parquet": "decanter-gateway-parquet",
}
"""The Debian package in which an extra of this program is, by the extra's name."""


def missing_sentence(extra: str, error: ImportError) -> str:
    """What is missing of an extra, or of this program, and what would be right, as the end of a sentence."""
    if isinstance(error, ModuleNotFoundError) and (lacking := missing_part(error)):
        return lacking
    return (
        f"needs {error.name or error}, which is not installed; pip install 'decanter-gateway[{extra}]', or on Debian "
        f"install the package {DEBIAN_PACKAGES[extra]}"
    )
