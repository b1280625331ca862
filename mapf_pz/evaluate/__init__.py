"""Metrics, and runs of policies over instances."""
