"""Experiments on the report's ideas for future work."""
