"""Checks of texts, intervals and episodes."""
