"""Planners outside of this package: programs that write plan files, and plan files that exist. Read `command.py` first.

Their plans are validated and then executed in the environment, so that all metrics are those of other policies.
"""
