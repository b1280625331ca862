"""TorchRL on the kernels: the batched environment, models, algorithms, training. Needs the extra `train`."""
