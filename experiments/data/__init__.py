"""Programs that write the data of the package: the packs of benchmarks, and the digests of suites."""
