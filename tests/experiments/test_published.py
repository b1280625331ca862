"""The authors' runs, repeated: the rows of the table, and the settings."""

import csv
import subprocess
import sys

import pytest
import tyro

from experiments.report import published


def test_rows_are_means_over_seeds_of_the_first_and_the_last_evaluation(tmp_path, monkeypatch):
    example = "env_steps,mean_reward,min_reward,max_reward,finished,fresh_reward,fresh_finished"
    for seed, last in enumerate((10, 30)):
        run = published.folder(tmp_path, "as published", seed)
        run.mkdir()
        lines = [example, "250000,100,1,2,3,200,0.2", f"500000,{last},1,2,9,400,0.6"]
        (run / "curve.csv").write_text("\n".join(lines))
    unfinished = published.folder(tmp_path, "as published", 2)
    unfinished.mkdir()
    (unfinished / "curve.csv").write_text(f"{example}\n250000,100,1,2,3,200,0.2\n")
    monkeypatch.setattr(published, "CURVES", tmp_path / "curves.csv")
    monkeypatch.setattr(published, "write", lambda: None)
    published.collect(tmp_path)
    (*_, line) = published.table(published.read_runs())
    assert line == "| as published | 2 | 500,000 | 100 → 20 (10 to 30) | 9.0 | 200 → 400 | 0.2 → 0.6 |"
    published.collect(tmp_path / "none")
    assert [line] == list(published.table(published.read_runs()))[2:], "earlier runs are kept"


def test_runs_whose_evaluations_are_known_are_not_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr(published, "EXAMPLE", tmp_path / "missing.py")
    published.run(settings=("as published",), output=tmp_path)
    assert not list(tmp_path.iterdir())
    longer = published.Setting(steps=1_000_000)
    monkeypatch.setitem(published.SETTINGS, "as published", longer)
    with pytest.raises(subprocess.CalledProcessError):
        published.run(settings=("as published",), output=tmp_path)


def test_single_differences_are_compared_after_the_same_steps():
    curves = published.single_differences(published.read_runs())
    lengths = {curve[-1, 0] for runs in curves.values() for curve in runs}
    assert len(lengths) == 1
    assert min(lengths) >= published.SHORT


def test_the_options_of_all_settings_are_the_examples():
    pytest.importorskip("stable_baselines3")
    sys.path.insert(0, str(published.EXAMPLE.parent))
    import report_published

    sys.path.remove(str(published.EXAMPLE.parent))
    planned = published.SETTINGS.values()
    settings = [tyro.cli(report_published.Example, args=(*run.options, f"--steps={run.steps}")) for run in planned]
    assert len({str(setting) for setting in settings}) == len(settings)
    for setting in settings:
        report_published.make_env(setting)
    with published.CURVES.open(newline="") as file:
        assert {row["setting"] for row in csv.DictReader(file)} <= set(published.SETTINGS)
