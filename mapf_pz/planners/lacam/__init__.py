"""Lazy constraints addition search (LaCAM)."""
