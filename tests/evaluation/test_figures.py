import pytest

from mapf_pz.evaluation import Episode

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")

from mapf_pz.evaluation.figures import draw_figures  # noqa: E402


def episodes(task_name, counts, *names, **metrics):
    return [
        Episode(name, task_name, count, number, {metric: value + number for metric, value in metrics.items()})
        for name in names
        for count in counts
        for number in range(3)
    ]


def test_a_figure_for_each_task_with_several_numbers_of_agents(tmp_path):
    drawn = draw_figures(
        episodes("maze, 8 x 8", [4, 8, 16], "pibt", "random", CSR=0.5, ISR=0.5, step_ms=1.0)
        + episodes("warehouse", [10], "pibt", CSR=1.0, ISR=1.0)
        + episodes("lifelong", [8, 4], "pibt", avg_throughput=1.0, step_ms=0.1),
        tmp_path,
    )
    assert drawn == [tmp_path / "maze--8-x-8.png", tmp_path / "lifelong.png"]
    assert sorted(tmp_path.iterdir()) == sorted(drawn)
    widths = []
    for file in drawn:
        with Image.open(file) as image:
            widths.append(image.width)
    assert 2 * widths[0] == pytest.approx(3 * widths[1], abs=3)  # a panel for each metric


def test_policies_of_one_number_of_agents_have_no_figure(tmp_path):
    assert draw_figures(episodes("maze", [4], "pibt", "random", CSR=1.0), tmp_path) == []
    assert draw_figures([], tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_a_policy_with_fewer_numbers_of_agents(tmp_path):
    tried = episodes("maze", [4], "random", CSR=1.0) + episodes("maze", [4, 8], "pibt", CSR=1.0)
    assert len(draw_figures(tried, tmp_path)) == 1


def test_names_are_no_formulas(tmp_path):
    (file,) = draw_figures(episodes(r"cost $\frac{", [1, 2], "$x_$", CSR=1.0), tmp_path)
    assert file.exists()
