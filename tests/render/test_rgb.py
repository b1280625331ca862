import numpy as np
import pytest

from mapf_pz.render.rgb import FREE, OBSTACLE, Canvas, agent_colors, draw, fitting_cell_size

FREE_MAP = np.ones((3, 4), np.bool_)
AWAY = np.array([[2, 3]])


def cell(picture, row, col, size):
    return picture[row * size : (row + 1) * size, col * size : (col + 1) * size].astype(int)


def test_shape_and_background():
    free = np.array([[True, False], [True, True]])
    picture = draw(free, np.zeros((0, 2), int), None, np.zeros((0, 2), int), cell_size=10)
    assert picture.shape == (20, 20, 3)
    assert picture.dtype == np.uint8
    assert (cell(picture, 0, 1, 10) == OBSTACLE).all()
    assert (cell(picture, 1, 1, 10) == FREE).all()


@pytest.mark.parametrize(
    ("shape", "size"), [((12, 12), 48), ((63, 161), 8), ((256, 256), 6), ((32, 32), 43), ((600, 50), 6)]
)
def test_cell_size_fits_the_map(shape, size):
    assert fitting_cell_size(*shape) == size


def test_cell_size_of_nothing_is_an_error():
    with pytest.raises(ValueError, match="cell_size=0"):
        draw(FREE_MAP, AWAY, None, AWAY, cell_size=0)


@pytest.mark.parametrize("size", [6, 8, 13, 48])
def test_agent_has_its_color_and_its_goal_too(size):
    positions, goals = np.array([[0, 0], [1, 1]]), np.array([[2, 2], [2, 3]])
    picture = draw(FREE_MAP, positions, None, goals, cell_size=size)
    middle, margin = size // 2, round(0.03 * size)
    for agent, color in enumerate(agent_colors(2)):
        assert np.abs(cell(picture, *positions[agent], size)[middle, middle] - color).max() <= 1
        assert np.abs(cell(picture, *goals[agent], size)[margin, margin] - color).max() <= 1


@pytest.mark.parametrize("size", [7, 8, 24])
@pytest.mark.parametrize(("heading", "step"), [(0, (0, 1)), (1, (1, 0)), (2, (0, -1)), (3, (-1, 0))])
def test_mark_points_where_the_agent_looks(size, heading, step):
    position = np.array([[1, 1]])
    plain = cell(draw(FREE_MAP, position, None, AWAY, cell_size=size), 1, 1, size)
    marked = cell(draw(FREE_MAP, position, np.array([heading]), AWAY, cell_size=size), 1, 1, size)
    whitened = (marked - plain).sum(axis=2)
    offsets = np.arange(size) - (size - 1) / 2
    rows, cols = whitened.sum(axis=1) @ offsets, whitened.sum(axis=0) @ offsets
    assert (np.sign(np.round([rows, cols], 6)) == step).all()


@pytest.mark.parametrize("size", [8, 32])
def test_agent_on_its_goal_shows_both(size):
    both = cell(draw(FREE_MAP, AWAY, None, AWAY, cell_size=size), 2, 3, size)
    agent = cell(draw(FREE_MAP, AWAY, None, np.array([[0, 0]]), cell_size=size), 2, 3, size)
    goal = cell(draw(FREE_MAP, np.array([[0, 0]]), None, AWAY, cell_size=size), 2, 3, size)
    margin, middle = round(0.03 * size), size // 2
    assert (both[margin, margin] == goal[margin, margin]).all()
    assert (both[middle, middle] == agent[middle, middle]).all()


def test_inactive_agent_is_left_out_with_its_goal():
    positions, goals = np.array([[0, 0], [1, 1]]), np.array([[0, 2], [2, 2]])
    picture = draw(FREE_MAP, positions, np.array([0, 1]), goals, np.array([True, False]), cell_size=8)
    alone = draw(FREE_MAP, positions[:1], np.array([0]), goals[:1], cell_size=8)
    assert (picture == alone).all()


def test_a_canvas_keeps_no_earlier_image():
    canvas = Canvas(FREE_MAP, 1, cell_size=8)
    first = canvas.draw(np.array([[0, 0]]), np.array([0]), AWAY)
    canvas.draw(np.array([[1, 1]]), np.array([3]), AWAY)
    assert (canvas.draw(np.array([[0, 0]]), np.array([0]), AWAY) == first).all()


def test_colors_are_different_and_readable_on_the_background():
    colors = agent_colors(50)
    apart = np.abs(colors[:, None] - colors[None]).sum(axis=2)
    assert apart[~np.eye(50, dtype=np.bool_)].min() > 6
    assert np.abs(colors - FREE).sum(axis=1).min() > 150


@pytest.mark.parametrize("headings", [None, np.array([0, 3])])
@pytest.mark.parametrize("size", [6, 9, 13, 48])
def test_a_dark_bar_crosses_delayed_agents(size, headings):
    positions, goals = np.array([[1, 1], [2, 3]]), np.array([[0, 0], [0, 1]])
    plain = draw(FREE_MAP, positions, headings, goals, cell_size=size)
    marked = draw(FREE_MAP, positions, headings, goals, delayed=np.array([True, False]), cell_size=size)
    before, after = cell(plain, 1, 1, size), cell(marked, 1, 1, size)
    brightness = after.mean(axis=2) - before.mean(axis=2)
    assert brightness.max() <= 0
    assert brightness.min() < -80
    darker = np.flatnonzero((brightness < 0).any(axis=1))
    assert size / 2 < darker.min() <= darker.max() < 0.9 * size  # in the lower half
    marked[size : 2 * size, size : 2 * size] = plain[size : 2 * size, size : 2 * size]
    np.testing.assert_array_equal(marked, plain)  # the other agent has no bar


def test_an_inactive_agent_has_no_bar():
    positions, goals = np.array([[0, 0], [1, 1]]), np.array([[0, 2], [2, 2]])
    active, delayed = np.array([True, False]), np.array([False, True])
    picture = draw(FREE_MAP, positions, None, goals, active, delayed, cell_size=8)
    np.testing.assert_array_equal(picture, draw(FREE_MAP, positions, None, goals, active, cell_size=8))
