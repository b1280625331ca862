"""Whether curiosity helps: the results of runs, which are not repeated, and their table."""

from dataclasses import replace

import pytest

pytest.importorskip("torchrl")

from experiments.ideas import curiosity


def test_results_of_runs_and_their_table(tmp_path, monkeypatch):
    trained, tables = [], []

    def write_progress(config, run, overwrite):
        assert overwrite
        trained.append((config.curiosity.kind, config.seed))
        run.mkdir(parents=True)
        rates = [0.0, 0.5, 0.95, 0.8, 1.0] if config.curiosity.kind == "rnd" else [0.0] * 5
        rows = [f"{1000 * k},{rate}" for k, rate in enumerate(rates, 1)]
        (run / "progress.csv").write_text("\n".join(["agent_steps,ISR", *rows]))

    monkeypatch.setattr(curiosity, "train", write_progress)
    monkeypatch.setattr(curiosity, "STUDY", replace(curiosity.STUDY, file=tmp_path / "curiosity.csv"))
    monkeypatch.setattr(curiosity, "write_table", lambda page, name, lines: tables.append((name, list(lines))))
    curiosity.main(curiosity.Options(output=tmp_path, seeds=(0,)))
    assert len(trained) == 5
    curiosity.main(curiosity.Options(output=tmp_path, seeds=(0, 1)))
    assert len(trained) == 10
    name, lines = tables[-1]
    assert name == "curiosity"
    assert lines[2:4] == ["| `none` | not, not | 0.00 |", "| `rnd` | 3, 3 | 1.00 |"]
