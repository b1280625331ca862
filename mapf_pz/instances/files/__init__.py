"""Readers and writers of map, scenario and problem files, one format each. Read `movingai.py` first."""
