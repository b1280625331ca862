"""The PettingZoo environment: `parallel_env`, its AEC form `env`, and their class `MapfEnv`.

It imports the simulator and rendering. Read `mapf_env.py` first.
"""

import lazy_loader

# The names are those of `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
