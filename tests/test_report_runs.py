"""The authors' runs, repeated: the rows of the table, and the settings."""

import csv
import subprocess
import sys

import pytest
import tyro

from experiments import report_runs


def test_rows_are_means_over_seeds_of_the_first_and_the_last_evaluation(tmp_path, monkeypatch):
    example = "env_steps,mean_reward,min_reward,max_reward,finished,fresh_reward,fresh_finished"
    for seed, last in enumerate((10, 30)):
        run = report_runs.folder(tmp_path, "as published", seed)
        run.mkdir()
        lines = [example, "250000,100,1,2,3,200,0.2", f"500000,{last},1,2,9,400,0.6"]
        (run / "curve.csv").write_text("\n".join(lines))
    unfinished = report_runs.folder(tmp_path, "as published", 2)
    unfinished.mkdir()
    (unfinished / "curve.csv").write_text(f"{example}\n250000,100,1,2,3,200,0.2\n")
    monkeypatch.setattr(report_runs, "CURVES", tmp_path / "curves.csv")
    monkeypatch.setattr(report_runs, "write", lambda: None)
    report_runs.collect(tmp_path)
    (*_, line) = report_runs.table(report_runs.read_runs())
    assert line == "| as published | 2 | 500,000 | 100 → 20 (10 to 30) | 9.0 | 200 → 400 | 0.2 → 0.6 |"
    report_runs.collect(tmp_path / "none")
    assert [line] == list(report_runs.table(report_runs.read_runs()))[2:], "earlier runs are kept"


def test_runs_whose_evaluations_are_known_are_not_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr(report_runs, "EXAMPLE", tmp_path / "missing.py")
    report_runs.run(settings=("as published",), output=tmp_path)
    assert not list(tmp_path.iterdir())
    longer = report_runs.Setting(steps=1_000_000)
    monkeypatch.setitem(report_runs.SETTINGS, "as published", longer)
    with pytest.raises(subprocess.CalledProcessError):
        report_runs.run(settings=("as published",), output=tmp_path)


def test_single_differences_are_compared_after_the_same_steps():
    curves = report_runs.single_differences(report_runs.read_runs())
    lengths = {curve[-1, 0] for runs in curves.values() for curve in runs}
    assert len(lengths) == 1
    assert min(lengths) >= report_runs.SHORT


def test_the_options_of_all_settings_are_the_examples():
    pytest.importorskip("stable_baselines3")
    sys.path.insert(0, str(report_runs.EXAMPLE.parent))
    import report_published

    sys.path.remove(str(report_runs.EXAMPLE.parent))
    planned = report_runs.SETTINGS.values()
    settings = [tyro.cli(report_published.Example, args=(*run.options, f"--steps={run.steps}")) for run in planned]
    assert len({str(setting) for setting in settings}) == len(settings)
    for setting in settings:
        report_published.make_env(setting)
    with report_runs.CURVES.open(newline="") as file:
        assert {row["setting"] for row in csv.DictReader(file)} <= set(report_runs.SETTINGS)
