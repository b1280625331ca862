"""Training with TorchRL: the batched environment, networks, algorithms, the training loop and trained policies.

It imports neither the environment nor the wrappers. Read `training/train.py` first. Needs the extra `train`;
configurations and presets can be imported without loading torch.
"""

import lazy_loader

# The names are those of `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
