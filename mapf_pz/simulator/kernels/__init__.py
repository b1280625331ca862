"""The kernels: compiled functions over plain arrays, which allocate nothing and draw no random numbers.

Read `step.py` first; `state.py` lists the arrays. They import no other part of the simulator but its actions.
"""
