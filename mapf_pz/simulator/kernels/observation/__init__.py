"""What agents observe: the kernels that draw it."""
