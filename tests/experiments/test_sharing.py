"""What information sharing is worth: runs whose validations are known are not repeated; the figure has all curves."""

from dataclasses import replace

import pytest

pytest.importorskip("torchrl")

from experiments.ideas import sharing


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """Two validations are written instead of trainings; the list of the runs that were trained."""
    runs = []

    def write_progress(config, run, overwrite):
        assert overwrite
        runs.append((run.name, config.seed))
        run.mkdir(parents=True)
        numbers = "\n".join(f"{steps},0.{config.seed}5,0.5,1.25" for steps in (30_000, 60_000))
        (run / "progress.csv").write_text(f"agent_steps,validation_CSR,validation_ISR,validation_return\n{numbers}\n")

    monkeypatch.setattr(sharing, "train", write_progress)
    monkeypatch.setattr(sharing, "STUDY", replace(sharing.STUDY, file=tmp_path / "sharing.csv"))
    monkeypatch.setattr(sharing, "IMAGE", tmp_path / "sharing.png")
    return runs


@pytest.mark.slow
def test_runs_whose_validations_are_known_are_not_repeated(tmp_path, trained):
    sharing.main(sharing.Options(output=tmp_path, seeds=(0,)))
    assert len(trained) == 8 * 2 * 2, "what agents know, algorithms, densities"
    sharing.main(sharing.Options(output=tmp_path, seeds=(0, 1)))
    assert [seed for _, seed in trained] == [0] * 32 + [1] * 32
    assert [row["CSR"] for row in sharing.STUDY.rows()] == ["0.050"] * 64 + ["0.150"] * 64
    assert sharing.IMAGE.stat().st_size > 10_000
