"""Training runs: collection, the training loop, checkpoints, progress and processes. Read `updates.py` first."""
