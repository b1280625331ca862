"""Evaluation in POGEMA, and policies for it. Read `pogema.py` first."""
