"""Measurements of the speed of environments, for `mapf-pz benchmark`."""
