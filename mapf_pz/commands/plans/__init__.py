"""The commands that make, validate and execute plans. Read `planfile.py` first, which loads plan files."""
