"""Pictures of guidance graphs."""

from xml.etree import ElementTree

import numpy as np
import pytest

from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.instance import Grid
from mapf_pz.render.guidance import ARROW, HOT, preferences, save_guidance_picture
from mapf_pz.render.rgb import FREE, OBSTACLE

SVG = "{http://www.w3.org/2000/svg}"
GRID = Grid([[True, True, True], [True, False, True]], "hall")
UNIFORM = GuidanceGraph.uniform(GRID.free)


def changed(weights):
    """Return the uniform graph with other weights of some moves, by (heading, row, col)."""
    move = UNIFORM.move.copy()
    for edge, weight in weights.items():
        move[edge] = weight
    return GuidanceGraph(move, UNIFORM.wait)


@pytest.mark.parametrize(("weight", "strength"), [(0.5, 0.5), (0.25, 1), (0.01, 1), (2, -0.5), (np.inf, -1)])
def test_the_cheaper_direction_is_preferred_by_the_ratio(weight, strength):
    graph = changed({(0, 0, 1): weight})  # east, to [0, 2]
    expected = np.zeros((4, 2, 3))
    expected[(0, 0, 1) if strength > 0 else (2, 0, 2)] = abs(strength)
    np.testing.assert_allclose(preferences(graph, GRID.free), expected, atol=1e-6)


def test_edges_that_are_blocked_both_ways_have_no_direction():
    assert not preferences(changed({(0, 0, 1): np.inf, (2, 0, 2): np.inf}), GRID.free).any()


def svg(tmp_path, graph, moves=None):
    save_guidance_picture(graph, GRID, tmp_path / "a.svg", moves)
    return ElementTree.parse(tmp_path / "a.svg").getroot()


def test_arrows_point_in_the_cheaper_direction(tmp_path):
    root = svg(tmp_path, changed({(0, 0, 1): 0.5, (3, 1, 0): 0.1}))  # east to [0, 2], and north to [0, 0]
    arrows = [
        np.array([[float(number) for number in corner.split(",")] for corner in polygon.get("points").split()])
        for polygon in root.iter(f"{SVG}polygon")
    ]
    east, north = arrows
    np.testing.assert_allclose([(east[:, 0].min() + east[0, 0]) / 2, east[0, 1]], [2, 0.5], atol=1e-3)
    assert east[0, 0] == east[:, 0].max()
    np.testing.assert_allclose([north[0, 0], (north[:, 1].max() + north[0, 1]) / 2], [0.5, 1], atol=1e-3)
    assert north[0, 1] == north[:, 1].min()
    assert np.ptp(north[:, 1]) > np.ptp(east[:, 0])  # a larger ratio
    assert [float(polygon.get("opacity")) for polygon in root.iter(f"{SVG}polygon")] == pytest.approx(
        [0.675, 1], abs=0.01
    )


def cells_of(root):
    """Return the colors of cells, by [row, col]."""
    colors = np.empty((2, 3), object)
    for rect in root.iter(f"{SVG}rect"):
        first = int(rect.get("x"))
        colors[int(rect.get("y")), first : first + int(rect.get("width"))] = rect.get("fill")
    return colors


def code(color):
    return "#{:02x}{:02x}{:02x}".format(*color)


def test_cells_are_colored_by_their_mean_cost(tmp_path):
    colors = cells_of(svg(tmp_path, changed({(1, 0, 0): 3})))  # [0, 0] has the mean cost 2
    assert colors[0, 0] == code(HOT)
    assert colors[1, 1] == code(OBSTACLE)
    assert set(colors[GRID.free]) == {code(HOT), code(FREE)}
    assert set(cells_of(svg(tmp_path, UNIFORM))[GRID.free]) == {code(FREE)}


def test_cells_are_colored_by_traffic(tmp_path):
    moves = np.zeros((4, 2, 3))
    moves[1, 0, 2] = 4  # into [1, 2]
    colors = cells_of(svg(tmp_path, UNIFORM, moves))
    assert colors[1, 2] == code(HOT)
    assert colors[0, 2] == code(FREE)


def test_an_image(tmp_path):
    image = pytest.importorskip("PIL.Image")
    save_guidance_picture(changed({(0, 0, 1): 0.1}), GRID, tmp_path / "a.png", cell_size=20)
    pixels = np.asarray(image.open(tmp_path / "a.png"))
    assert pixels.shape == (40, 60, 3)
    assert tuple(pixels[30, 30]) == OBSTACLE
    assert np.abs(pixels[10, 40].astype(int) - ARROW).max() <= 2  # between [0, 1] and [0, 2]
    assert tuple(pixels[1, 40]) != ARROW


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": "a.gif"}, r"a\.gif: expected a file name that ends in \.png, \.svg"),
        ({"cell_size": 0}, "cell_size=0: expected 1 pixel or more"),
        ({"moves": np.zeros((4, 3, 3))}, r"moves: expected the shape \(4, 2, 3\), got \(4, 3, 3\)"),
        ({"graph": GuidanceGraph.uniform(np.ones((3, 3), np.bool_))}, r"guidance graph of shape \(3, 3\)"),
    ],
)
def test_refusals(tmp_path, monkeypatch, changes, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        save_guidance_picture(**{"graph": UNIFORM, "grid": GRID, "path": "a.svg"} | changes)
    assert not list(tmp_path.iterdir())
