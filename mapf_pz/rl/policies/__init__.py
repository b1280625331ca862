"""Trained policies: loading and acting; those of the package are in `bundled/`. Read `policy.py` first."""
