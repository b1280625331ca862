"""The benchmarks that come with the package: packed data, and what reads them by name.

`README.md` in this folder names sources and licenses. Read `packs.py` first.
"""
