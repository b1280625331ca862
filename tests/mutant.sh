#!/usr/bin/env bash
# The tests that a mutant must fail, those that see most first, without plugins; mutants of kernels as plain Python.
set -e
export MAPF_PZ_DECISIONS=1 PYTHONDONTWRITEBYTECODE=1 PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OMP_NUM_THREADS=1
# They take less than half of so many seconds of the processor; a mutant that takes more is in an endless loop.
tests() { (ulimit -t "$1"; exec "$MAPF_PZ_PYTHON" -m pytest -x -p no:cacheprovider "${@:2}"); }

rules() {
    local reference=tests/simulator/test_against_reference.py
    tests 30 "$reference::test_observations[rotate-soft-restart]" "$reference::test_observations[cardinal-priority-nothing]"
    # Of the slowest, some.
    tests 90 tests/simulator/test_collision_table.py tests/environment/test_env.py tests/simulator/test_cost_to_go.py \
        "$reference" \
        -k "not (thousands_of_steps or api or registries or seeds or aec or reproducible or nothing-many or nothing-one \
            or restart-one or (hands and (cardinal-soft or rotate-block or cardinal-priority or rotate-priority-nothing)) \
            or (observations and (cardinal-soft-nothing or cardinal-soft-finish or rotate-priority \
            or rotate-block_both-finish or rotate-block_both-restart or cardinal-block_both-nothing \
            or cardinal-block_both-restart or rotate-soft-restart or cardinal-priority-nothing)))"
}

# What planners decided when that was recorded tells more than drawn cases do, which take long in plain Python.
planners() {
    local files recorded=$1 slow="wants or plain_python or legal or prevented or earliest or exactly or benchmark"
    mapfile -t files < <(printf "tests/planners/test_%s.py\n" "${@:2}")
    tests 25 tests/planners/test_decisions.py "${files[@]}" -p _hypothesis_pytestplugin -W "ignore:overflow:RuntimeWarning" \
        -k "(as_recorded and ($recorded)) or not (recorded or $slow or narrow or no_more_room or time_makes or likes_best \
            or share_goals or seed)"
}

# Packages that are not compiled: the module's own tests, those of the other arguments and those of the folder, which is
# the first, without those that start processes.
package() {
    local own
    own=$(basename "$file" .py)
    tests 300 $(compgen -G "$1/test_${own:0:5}*.py") "${@:2}" "$1" -p _hypothesis_pytestplugin \
        -k "not (test_ray or on_ray or ray_does or processes or process or killed or sigterm or any_text or any_value or mutated or time_makes \
            or stable_baselines or left_behind or worker or compiles or read_or_refused or test_benchmark)"
}

file=$(git diff --name-only)
# Kernels, as plain Python.
case $file in
    mapf_pz/simulator/kernels/* | mapf_pz/simulator/metrics.py) NUMBA_DISABLE_JIT=1 rules; exit ;;
    mapf_pz/planners/random.py) NUMBA_DISABLE_JIT=1 planners "(pibt or shield or refine) and not epibt" pibt shield; exit ;;
    mapf_pz/planners/pibt/*kernels.py) NUMBA_DISABLE_JIT=1 planners "(pibt or shield) and not epibt" pibt shield; exit ;;
    mapf_pz/planners/epibt/kernels.py) NUMBA_DISABLE_JIT=1 planners epibt epibt; exit ;;
    mapf_pz/planners/lacam/s*.py) NUMBA_DISABLE_JIT=1 planners lacam lacam; exit ;;
    mapf_pz/planners/sipp/reservations.py | mapf_pz/planners/sipp/search.py)
        NUMBA_DISABLE_JIT=1 planners "prioritized or refine" prioritized refine neighborhood; exit ;;
    mapf_pz/planners/sipp/improve.py | mapf_pz/planners/sipp/neighborhood.py)
        NUMBA_DISABLE_JIT=1 planners refine refine neighborhood; exit ;;
esac

case $file in
    mapf_pz/rl/*) package tests/rl tests/rl/test_{update,train,policies}.py ;;
    mapf_pz/evaluation/*) package tests/evaluation tests/commands/test_evaluate.py ;;
    mapf_pz/instances/*) package tests/instances tests/test_bad_input.py tests/commands/test_cli.py ;;
    mapf_pz/planners/plans/*) package tests/planners/plans tests/commands/test_validate.py ;;
    mapf_pz/planners/*) package tests/planners tests/commands/test_solve.py ;;
    mapf_pz/render/*) package tests/render tests/wrappers/test_record_episode.py tests/planners/plans/test_record.py ;;
    wrappers/*) package tests/wrappers ;;
esac
