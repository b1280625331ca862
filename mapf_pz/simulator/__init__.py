"""B environments of N agents as arrays: their configuration, actions, observations and metrics.

It imports instances, guidance graphs and what is internal. Read `kernels/step.py` first: one step of the environment.
"""

import lazy_loader

# The names are those of `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
