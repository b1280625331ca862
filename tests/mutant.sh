#!/usr/bin/env bash
# The tests that a mutant must fail, those that see most first, with the kernels as plain Python and without plugins.
set -e
export NUMBA_DISABLE_JIT=1 PYTHONDONTWRITEBYTECODE=1 PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
reference=tests/core/test_against_reference.py
tests() { timeout "$1" "$MAPF_PZ_PYTHON" -m pytest -x -p no:cacheprovider "${@:2}"; }
tests 30 "$reference::test_observations[rotate-soft-restart]" "$reference::test_observations[cardinal-priority-nothing]"
# Of the slowest, some.
tests 90 tests/core/test_collision_table.py tests/test_env.py tests/core/test_distance.py "$reference" \
    -k "not (ten_thousand or api or registries or seeds or aec or reproducible or nothing-many or nothing-one or restart-one \
        or (hands and (cardinal-soft or rotate-block or cardinal-priority or rotate-priority-nothing)) \
        or (observations and (cardinal-soft-nothing or cardinal-soft-finish or rotate-priority or rotate-block_both-finish \
        or rotate-block_both-restart or cardinal-block_both-nothing or cardinal-block_both-restart \
        or rotate-soft-restart or cardinal-priority-nothing)))"
