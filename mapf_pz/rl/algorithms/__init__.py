"""Algorithms. Read `algorithm.py` first, their base class, then `ppo_learner.py`, which computes PPO's loss."""
