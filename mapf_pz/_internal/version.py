"""The version of this package, which `pyproject.toml` states."""

from importlib.metadata import version

__version__ = version("mapf-pz")
"""The version, such as "0.1.0"."""
