"""`examples/report_env.py`: each defect of the published environment, and its repair."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from mapf_pz.instances import load_problem

EXAMPLES = Path(__file__).parents[1] / "examples"
FORWARD, LEFT = 2, 0


@pytest.fixture(scope="module")
def module():
    sys.path.insert(0, str(EXAMPLES))
    import report_env

    sys.path.remove(str(EXAMPLES))
    return report_env


def with_defects(module, *names, actions="weights"):
    return module.ReportEnv(replace(module.NO_DEFECTS, **dict.fromkeys(names, True)), actions)


def actions(**by_agent):
    """All agents stay, except those named `a0`, `a1`, ..."""
    values = np.full((10, 4), -1.0)
    values[:, 3] = 1
    for name, action in by_agent.items():
        values[int(name[1:])] = -1
        values[int(name[1:]), action] = 1
    return values


def beside(env, goal):
    """Return an empty cell beside a goal, and the direction from it to the goal."""
    for direction, (dx, dy) in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)]):
        cell = (goal[0] - dx, goal[1] - dy)
        if min(cell) >= 0 and env.grid[cell] == 0:
            return cell, direction
    raise AssertionError("no empty cell")


def put(env, i, cell, direction):
    """Put agent `i` on an empty cell."""
    env.grid[tuple(env.positions[i])] = 0
    env.grid[cell], env.positions[i], env.directions[i] = 3 + i, cell, direction


@pytest.mark.parametrize("actions", ["number", "weights"])
@pytest.mark.parametrize("defects", [True, False])
def test_gymnasiums_checker(module, defects, actions):
    """With all defects but one: with agents that stay finished, the second episode is not the first."""
    defects = replace(module.Defects(), finished=False) if defects else module.NO_DEFECTS
    check_env(module.ReportEnv(defects, actions), skip_render_check=True)


def test_an_action_is_a_number(module):
    """-1 turns left, -1/3 right, 1/3 moves forward, 1 stays; the middle, 0, moves forward."""
    env = with_defects(module, "blocked", actions="number")
    for value, reward in ((-1, 0.1), (-0.7, 0.1), (-0.6, 0.1), (-0.01, 0.1), (0, 1.0), (0.6, 1.0), (0.7, 0), (1, 0)):
        env.reset(seed=0)
        assert env.step(np.full(10, value))[1] == pytest.approx(reward)
    directions = env.directions.copy()
    env.step(np.full(10, -1))
    assert ((directions - env.directions) % 4 == 1).all()
    env.step(np.full(10, -1 / 3))
    assert (directions == env.directions).all()


def test_walls_are_in_the_plane_of_goals_while_an_action_is_a_number(module):
    number, weights = with_defects(module, actions="number"), with_defects(module)
    plane, goals = number.reset(seed=0)[0][1::3], weights.reset(seed=0)[0][1::3]
    walls = weights.observe()[::3] == np.float32(2 / 3)
    np.testing.assert_allclose(plane, goals + np.float32(5 / 3) * walls, rtol=1e-6)
    assert walls.any()


def test_a_seed_decides_everything(module):
    first, second = (module.ReportEnv(actions="weights") for _ in range(2))
    rng = np.random.default_rng(0)
    assert np.array_equal(first.reset(seed=3)[0], second.reset(seed=3)[0])
    for action in rng.uniform(-1, 1, (50, 10, 4)):
        (one, reward, *_), (other, same, *_) = first.step(action), second.step(action)
        assert np.array_equal(one, other)
        assert reward == same


def test_starts_and_goals(module):
    problem = load_problem("warehouse_small_10")
    right, wrong = with_defects(module), with_defects(module, "header")
    right.reset(seed=0)
    wrong.reset(seed=0)
    assert right.positions.tolist() == problem.starts.tolist()
    assert right.goals.tolist() == problem.errands[:10].tolist()
    assert wrong.positions.tolist() == [[0, 10], *problem.starts[:9].tolist()]
    assert wrong.goals[1:].tolist() == problem.errands[:9].tolist()
    first = wrong.goals[0].tolist()
    wrong.reset()
    assert wrong.goals[0].tolist() != first


def test_the_authors_starts_and_goals(module):
    """They are free in the map that is upside down. The first of each is a number of the file's first line."""
    env = module.ReportEnv()
    assert env.starts == [(0, 10), *(divmod(number, 57) for number in module.STARTS[:9])]
    assert all(env.cells[cell] == module.EMPTY for cell in env.starts)
    first, second = (env.reset(seed=seed) and env.goals.tolist() for seed in (0, 1))
    same = [one == other for one, other in zip(first, second, strict=True)]
    assert same == [False, True, True, False, False, True, True, True, True, True]


def test_an_agent_beside_a_goal_finishes(module):
    env = with_defects(module, "finished")
    env.reset(seed=0)
    cell, direction = beside(env, env.goals[4].tolist())
    put(env, 4, cell, direction)
    *_, info = (result := env.step(actions(a4=FORWARD)))
    assert result[1] == pytest.approx(20.1)
    assert info["finished"] == 1
    assert env.positions[4].tolist() == list(cell)  # it does not enter
    assert env.step(actions(a4=LEFT))[1] == 0
    env.reset()
    assert env.step(actions(a4=LEFT))[1] == 0  # nor does it act in the next episode


def test_finished_agents_act_again_once_repaired(module):
    env = with_defects(module)
    env.reset(seed=0)
    env.finished[4] = True
    assert env.step(actions(a4=LEFT))[1] == 0
    env.reset()
    assert env.step(actions(a4=LEFT))[1] == pytest.approx(0.01)


@pytest.mark.parametrize("defect", [True, False])
def test_goals_of_others(module, defect):
    env = with_defects(module, *["any_goal"] * defect)
    env.reset(seed=0)
    goal = tuple(env.goals[5].tolist())
    cell, direction = beside(env, goal)
    put(env, 2, cell, direction)
    observation, reward, *_ = env.step(actions(a2=FORWARD))
    assert reward == pytest.approx(20.1 if defect else 0.1)
    assert env.finished[2] == defect
    if not defect:  # it stands on the other's goal, which is there again when it has left
        env.directions[2] = (direction + 2) % 4
        env.step(actions(a2=FORWARD))
        assert env.grid[goal] == module.GOAL
        assert [plane.sum() <= 1 / 3 for plane in observation[1::3]] == [True] * 10  # its own goal, if any


@pytest.mark.parametrize("defect", [True, False])
def test_blocked_moves(module, defect):
    env = with_defects(module, *["blocked"] * defect)
    env.reset(seed=0)
    put(env, 0, (5, 3), 2)
    env.grid[4, 3] = module.WALL
    assert env.step(actions(a0=FORWARD))[1] == pytest.approx(0.1 * defect)
    assert env.positions[0].tolist() == [5, 3]


@pytest.mark.parametrize("defect", [True, False])
def test_the_border(module, defect):
    env = with_defects(module, *["border"] * defect)
    env.reset(seed=0)
    put(env, 0, (4, 0), 3)
    assert env.step(actions(a0=LEFT))[1] == pytest.approx(0 if defect else 0.01)
    assert env.directions[0] == (3 if defect else 2)


def test_views(module):
    """An agent in the middle of the last row sees ahead; bytes lose thirds; a transposed view is the same numbers."""
    plain, cut, turned = (with_defects(module, *names) for names in ((), ("bytes",), ("transposed",)))
    views = [env.reset(seed=1)[0] for env in (plain, cut, turned)]
    for i, direction in enumerate(plain.directions):
        x = 10 if direction in {0, 3} else 9  # beside the middle in the other directions
        assert views[0][3 * i, x, 19] == pytest.approx(10 / 3)
        assert views[0][3 * i + 2, x, 19] == pytest.approx(direction / 3)
    assert np.array_equal(views[1], np.floor(views[0] + 1e-6))
    assert np.array_equal(views[2], views[0].transpose(2, 0, 1))


def test_the_cell_ahead_of_an_agent(module):
    env = with_defects(module)
    env.reset(seed=0)
    for direction, (dx, dy) in enumerate(module.DIRECTIONS.tolist()):
        put(env, 0, (15, 30), direction)
        before = env.grid[15 + dx, 30 + dy]
        env.grid[15 + dx, 30 + dy] = module.WALL
        x = 10 if direction in {0, 3} else 9
        assert env.observe()[0, x, 18] == pytest.approx(2 / 3)
        env.grid[15 + dx, 30 + dy] = before


def test_walls_hide_what_is_behind_them(module):
    env = with_defects(module, "occluded")
    env.reset(seed=0)
    env.grid[:] = 0
    env.positions[:] = (31, 55)  # all agents together, out of the way
    put(env, 0, (20, 28), 3)
    env.grid[:, 25] = module.WALL  # a wall three cells ahead
    view = env.observe()[0]
    assert (view[:, 16] == np.float32(2 / 3)).all()
    assert (view[:, :16] == 0).all()
    assert (view[:, 17:] > 0).all()


def test_a_mistyped_defect_is_one_line(module):
    sys.path.insert(0, str(EXAMPLES))
    report = pytest.importorskip("report_published")
    sys.path.remove(str(EXAMPLES))
    for typo in (report.Example(repair=("typo",)), report.Example(keep=("typo",))):
        with pytest.raises(ValueError, match="typo: no defect; expected all, or some of bytes, transposed"):
            report.make_env(typo)


def test_defects_are_repaired_by_name(module):
    sys.path.insert(0, str(EXAMPLES))
    report = pytest.importorskip("report_published")
    sys.path.remove(str(EXAMPLES))

    def defects(**options):
        return report.make_env(report.Example(**options)).defects

    assert defects() == module.Defects()
    assert defects(repair=("all",)) == module.NO_DEFECTS
    assert defects(repair=("bytes", "border")) == replace(module.Defects(), bytes=False, border=False)
    assert defects(repair=("all",), keep=("blocked",)) == replace(module.NO_DEFECTS, blocked=True)
