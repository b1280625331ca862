"""Algorithms. Read `algorithm.py` first, their base class, then `ppo.py`, which computes PPO's loss."""
