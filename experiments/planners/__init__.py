"""Measurements of planners and guidance graphs."""
