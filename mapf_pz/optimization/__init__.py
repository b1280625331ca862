"""Optimization of guidance graphs: edge weights with which a planner or policy routes agents better.

It imports planners, policies and evaluation. Read `optimize.py` first.
"""
