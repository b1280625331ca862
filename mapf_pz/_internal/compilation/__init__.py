"""The compilation of kernels: the cache, what is to be compiled, and processes that compile it."""
