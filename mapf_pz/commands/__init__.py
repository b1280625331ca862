"""The commands of `mapf-pz`, one module each. Read `main.py` first, which loads them."""
