import json
from hashlib import sha1
from importlib import resources

import numpy as np
import pytest

from mapf_pz.instances import components, format_map, generate, load_map, map_names, write_bundled
from mapf_pz.instances.bundled import BUNDLED

MAPS = resources.files("mapf_pz.maps")
SEEDS = range(20)


def rng(seed=0):
    return np.random.default_rng(seed)


def drawing(grid):
    return format_map(grid).split("\n")[4:-1]


def num_components(grid):
    return components(grid.free).max() + 1


def test_empty_maps_and_warehouses_are_the_benchmarks(benchmark):
    empty = [format_map(generate.empty(size, size)) for size in (8, 16, 32, 48)]
    parameters = [(10, 20, 10, 2, 1), (10, 20, 10, 2, 2), (20, 40, 10, 2, 2)]
    warehouses = [format_map(generate.warehouse(*each), blocked="T") for each in parameters]
    names = [f"empty-{size}-{size}" for size in (8, 16, 32, 48)]
    names += ["warehouse-{}-{}-{}-{}-{}".format(*each) for each in parameters]
    for name, text in zip(names, [*empty, *warehouses], strict=True):
        assert text.encode() == (benchmark / "maps" / f"{name}.map").read_bytes()


def test_a_small_warehouse():
    grid = generate.warehouse(columns=2, rows=2, length=3, depth=1, aisle=1, margin=2)
    assert drawing(grid) == [
        "@@@@@@@@@@@@@",
        "@...........@",
        "@..@@@.@@@..@",
        "@...........@",
        "@..@@@.@@@..@",
        "@...........@",
        "@@@@@@@@@@@@@",
    ]
    assert grid.name == "warehouse-2-2-3-1-1"
    assert generate.warehouse(1, 1, 2, 1, 1, margin=0).shape == (5, 4)


@pytest.mark.parametrize(
    ("height", "width", "density", "obstacles"), [(12, 12, 0.15, 22), (7, 9, 0, 0), (5, 5, 0.99, 25)]
)
def test_random_has_the_obstacles_asked_for(height, width, density, obstacles):
    grid = generate.random(height, width, density, rng())
    assert grid.shape == (height, width)
    assert (~grid.free).sum() == obstacles


def test_random_differs_by_the_seed_alone():
    first, again, other = (generate.random(16, 16, 0.2, rng(seed)) for seed in (1, 1, 2))
    assert first.name == "random-16-16-20"
    assert np.array_equal(first.free, again.free)
    assert not np.array_equal(first.free, other.free)


@pytest.mark.parametrize(("shape", "corridor"), [((13, 13), 1), ((16, 16), 2), ((9, 20), 3), ((2, 2), 1)])
def test_mazes_are_connected_and_have_no_cycles(shape, corridor):
    for seed in SEEDS:
        grid = generate.maze(*shape, rng(seed), corridor)
        assert grid.shape == shape
        assert num_components(grid) == 1
        # Seen at one cell a room and one a passage, a tree has one edge less than cells.
        rooms, passages = grid.free[1 :: corridor + 1, 1 :: corridor + 1], []
        passages.append(grid.free[1 :: corridor + 1, corridor + 1 :: corridor + 1][:, : rooms.shape[1] - 1])
        passages.append(grid.free[corridor + 1 :: corridor + 1, 1 :: corridor + 1][: rooms.shape[0] - 1])
        assert rooms.all()
        assert sum(int(p.sum()) for p in passages) == rooms.size - 1


def test_loops_open_a_fraction_of_the_other_walls_of_a_maze():
    num_rooms, num_walls = 10 * 10, 2 * 10 * 9
    opened = []
    for seed in SEEDS:
        free = generate.maze(21, 21, rng(seed), loops=0.5).free
        opened.append(int(free.sum()) - num_rooms - (num_rooms - 1))  # rooms, then the passages of a tree
    assert np.mean(opened) / (num_walls - (num_rooms - 1)) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("shape", "density"), [((20, 20), 0.3), ((13, 17), 0.4), ((6, 30), 0.2), ((2, 9), 0.3)])
def test_walls_are_apart_from_each_other_and_from_the_edge(shape, density):
    for seed in SEEDS:
        grid = generate.walls(*shape, rng(seed), density)
        assert grid.shape == shape
        assert num_components(grid) == 1
        assert grid.free[[0, -1]].all()
        assert grid.free[:, [0, -1]].all()
        assert grid.free[::2, ::2].all()  # corridors have at least one cell
        assert (~grid.free).mean() <= density + 1 / grid.free.size


def test_walls_reach_their_density_where_there_is_space():
    for density in (0, 0.1, 0.3):
        walls = [float((~generate.walls(21, 21, rng(seed), density).free).mean()) for seed in SEEDS]
        assert np.mean(walls) == pytest.approx(density, abs=0.02)


def test_walls_as_drawn():
    assert drawing(generate.walls(7, 9, rng(1), 0.3)) == [
        ".........",
        ".@.@.@.@.",
        "...@...@.",
        ".@@@.@.@.",
        ".......@.",
        ".@@@@@@@.",
        ".........",
    ]


@pytest.mark.parametrize("shape", [(17, 21), (20, 18), (1, 2), (5, 30)])
def test_walls_of_primal2_join_posts(shape):
    for seed in SEEDS:
        grid = generate.primal2(*shape, rng(seed), 0.7, components=5)
        assert grid.shape == shape
        assert grid.free[::2, ::2].all()  # posts are in the other rows and columns, which begin outside of the map
    assert grid.name == f"primal2-{shape[0]}-{shape[1]}-70"


def test_walls_of_primal2_have_at_most_their_length():
    for seed in SEEDS:
        free = generate.primal2(21, 21, rng(seed), density=6 / 23**2, components=6).free  # one wall
        assert 0 < (~free).sum() <= 1 + 2 * 6
    assert generate.primal2(21, 21, rng(), density=5 / 23**2, components=6).free.all()


def test_walls_of_primal2_go_straight_on():
    def corners(straight):
        """Return the fraction of walls' inner posts at which they turn."""
        turns = straights = 0
        for seed in range(200):
            free = np.pad(generate.primal2(41, 41, rng(seed), 4 / 43**2, 4, straight).free, 1, constant_values=True)
            for row, col in np.argwhere(~free[2:-2:2, 2:-2:2]) * 2 + 2:
                up, down, left, right = (not free[row + y, col + x] for y, x in ((-1, 0), (1, 0), (0, -1), (0, 1)))
                straights += up + down + left + right == 2 and up == down
                turns += up + down + left + right == 2 and up != down
        return turns / (turns + straights)

    # Against one way straight on with the weight 0.9 are two others with 0.1; the way back is never free.
    assert corners(0.9) == pytest.approx(0.2 / 1.1, abs=0.06)
    assert corners(0.5) == pytest.approx(2 / 3, abs=0.08)


@pytest.mark.slow
def test_mazes_of_primal2_are_as_dense_as_those_of_pogema(pogema_benchmark):
    drawn = json.loads((pogema_benchmark / "02-mazes.maps.json").read_text()).values()
    theirs = [np.mean([cell == "." for row in rows for cell in row]) for rows in drawn]
    ours = []
    for seed in range(400):
        sample = rng(seed)
        height, width = sample.integers(17, 22, 2) // 2 * 2 + 1
        density, components = sample.uniform(0, 1), int(sample.integers(4, 9))
        grid = generate.primal2(height, width, sample, density, components, sample.uniform(0.75, 0.85))
        ours.append(float(grid.free.mean()))
    assert np.mean(ours) == pytest.approx(np.mean(theirs), abs=0.02)
    assert np.std(ours) == pytest.approx(np.std(theirs), abs=0.015)


def test_a_maze_as_drawn():
    grid = generate.maze(7, 7, rng(3), 2)
    rows = drawing(grid)
    assert rows[0] == "@" * 7
    assert rows[6] == "@" * 7
    assert all(row[0] == row[6] == "@" for row in rows)
    assert sum(row.count(".") for row in rows) == 4 * 4 + 3 * 2


@pytest.mark.parametrize(("shape", "size"), [((16, 16), 4), ((20, 20), 5), ((15, 22), 4), ((9, 9), 2)])
def test_rooms_are_connected_and_have_one_door_a_wall(shape, size):
    shut = total = 0
    for seed in SEEDS:
        grid = generate.room(*shape, rng(seed), size)
        assert grid.shape == shape
        assert num_components(grid) == 1
        assert not grid.free[0].any()
        assert not grid.free[:, 0].any()
        for free in (grid.free, grid.free.T):
            for top in range(size, free.shape[0], size):
                for left in range(0, free.shape[1], size):
                    doors = free[top, left + 1 : left + size].sum()
                    # A last column that is a wall has no room behind it.
                    if left + 1 < free.shape[1] and top + 1 < free.shape[0]:
                        assert doors <= 1
                        shut += doors == 0
                        total += 1
    assert 0.05 < shut / total < 0.35


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: generate.empty(0, 3), "height=0"),
        (lambda: generate.random(3, 3, 1.0, rng()), r"density=1\.0: expected at least 0 and less than 1"),
        (lambda: generate.random(3, 3, float("nan"), rng()), "density=nan"),
        (lambda: generate.maze(1, 9, rng()), "height=1"),
        (lambda: generate.maze(9, 9, rng(), corridor=0), "corridor=0"),
        (lambda: generate.maze(9, 9, rng(), corridor=2**63), "corridor=9223372036854775808"),
        (lambda: generate.room(9, 9, rng(), size=1), "size=1"),
        (lambda: generate.primal2(9, 0, rng(), 0.5), "width=0"),
        (lambda: generate.primal2(9, 9, rng(), 0.5, components=0), "components=0"),
        (lambda: generate.primal2(9, 9, rng(), 1.1), r"density=1\.1: expected a number from 0 to 1"),
        (lambda: generate.primal2(9, 9, rng(), 0.5, straight=1), "straight=1: expected at least 0 and less than 1"),
        (lambda: generate.warehouse(1, 1, 1, 1, 0), "aisle=0"),
        (lambda: generate.warehouse(1, 1, 1, 1, 1, margin=-1), "margin=-1"),
    ],
)
def test_invalid_parameters_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_the_bundled_files_are_what_the_table_makes(tmp_path):
    files = write_bundled(tmp_path / "maps")
    assert [file.stem for file in files] == map_names()
    for file in files:
        assert file.read_bytes() == (MAPS / file.name).read_bytes()


@pytest.mark.parametrize("name", BUNDLED)
def test_a_bundled_map_is_one_component_under_its_own_name(name):
    assert BUNDLED[name].make().name == name
    assert num_components(load_map(name)) == 1


def test_the_readme_of_the_maps_lists_them_all():
    text = (MAPS / "README.md").read_text()
    for name in BUNDLED:
        assert f"`{name}` | " in text
        assert str(load_map(name).free.sum()) in text


def test_walls_of_a_seed_do_not_change():
    digest = sha1()
    for seed in range(60):
        generator = rng(seed)
        grid = generate.walls(1 + seed % 40, 1 + 7 * seed % 41, generator, seed % 10 / 10)
        digest.update(grid.free.tobytes() + str(generator.integers(2**40)).encode())
    assert digest.hexdigest() == "19cab4b00e5e7519153db95253734ce023d5eb15"
