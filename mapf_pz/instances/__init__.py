"""Benchmark files, generators, and the sources that episodes come from."""
