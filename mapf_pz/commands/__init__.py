"""The commands of `mapf-pz`, one module each, and those of plans in `plans`. Read `main.py` first, which loads them."""
