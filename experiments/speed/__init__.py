"""Measurements of speed: `python -m experiments.speed COMMAND`. Read `runs.py` first."""
