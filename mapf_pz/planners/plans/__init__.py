"""Plans: validation, files, and recordings. Read `plan.py` first."""
