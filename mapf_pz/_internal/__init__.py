"""What no user imports: arrays, files, compilation, processes, and names of parts that users plug in.

It imports nothing else of the package but `mapf_pz.errors`. Read `jit.py` first, which compiles all kernels.
"""
