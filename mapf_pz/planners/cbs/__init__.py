"""Conflict-based search (CBS)."""
