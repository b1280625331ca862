#!/usr/bin/env bash
# The tests that a mutant must fail, the quickest first, with the kernels as plain Python.
export NUMBA_DISABLE_JIT=1 PYTHONDONTWRITEBYTECODE=1
exec "$MAPF_PZ_PYTHON" -m pytest -x -p no:cacheprovider \
    tests/core/test_collision_table.py tests/core/test_distance.py tests/test_env.py tests/core/test_against_reference.py \
    -k "not ten_thousand and not api and not registries and not seeds and not aec"
