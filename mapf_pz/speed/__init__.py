"""Measurements of the speed of environments, for `mapf-pz benchmark`. Read `candidates.py` first."""
