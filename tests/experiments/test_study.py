"""Studies: runs with results are not repeated, and results are written after each run."""

import pytest

from experiments.policies import candidates, imitation
from experiments.study import Study


@pytest.fixture
def study(tmp_path):
    return Study(tmp_path / "study.csv", ("setting", "seed"), ("CSR", "hours"))


RUNS = [("a", 0), ("b, c", 0), ("a", 1)]


def test_runs_with_results_are_not_repeated(study):
    assert list(study.missing(RUNS)) == RUNS
    study.add(("b, c", 0), {"CSR": "0.5", "hours": "1"})
    assert list(study.missing(RUNS)) == [("a", 0), ("a", 1)]


def test_what_is_added_meanwhile_is_not_missing(study):
    left = study.missing(RUNS)
    assert next(left) == ("a", 0)
    for run in RUNS:
        study.add(run, {"CSR": "1"})
    assert list(left) == []


def test_the_file_has_the_rows_of_each_run_in_order(study, capsys):
    study.add(("b, c", 0), {"CSR": "0.5", "hours": "1"}, {"CSR": "0.75", "hours": "2"})
    study.add(("a", 1), {"CSR": "1"})
    text = study.file.read_text()
    assert text == 'setting,seed,CSR,hours\n"b, c",0,0.5,1\n"b, c",0,0.75,2\na,1,1,\n'
    assert capsys.readouterr().out.count("'setting'") == 3


def test_columns_that_the_study_does_not_have_are_refused(study):
    with pytest.raises(ValueError, match="ISR"):
        study.add(("a", 0), {"ISR": "1"})


@pytest.mark.parametrize(
    ("main", "options", "message"),
    [
        (candidates.main, candidates.Options(candidates=("none", "of these")), "candidates none, of these: expected"),
        (imitation.main, imitation.Options(presets=("lifelong-cardinal", "x")), "presets x: expected some of oneshot"),
        (imitation.main, imitation.Options(settings=("own view", "y")), "settings y: expected some of own view, embed"),
    ],
)
def test_unknown_names_are_refused(main, options, message):
    with pytest.raises(SystemExit, match=message):
        main(options)
