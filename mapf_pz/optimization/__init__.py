"""Optimization of guidance graphs: edge weights with which a planner or policy routes agents better."""
