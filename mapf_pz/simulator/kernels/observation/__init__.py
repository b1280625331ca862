"""The kernels of observations. Read `channels.py` first, the table of channels, then `draw.py`, which draws them."""
