"""The seeds of episodes: those of training, evaluation and validation differ."""

from __future__ import annotations

FIRST_EVALUATION_SEED = 1_000_000
"""First seed of evaluations. Training uses smaller seeds and, when it is resumed, seeds from `FIRST_RESUMED_SEED`."""
FIRST_VALIDATION_SEED = 2_000_000
"""First seed of validations during training."""
FIRST_RESUMED_SEED = 2**31
"""First seed of training that is resumed."""
MAX_SEED = 2**128 - 1
"""Maximum seed, which is as large as those that NumPy chooses."""
