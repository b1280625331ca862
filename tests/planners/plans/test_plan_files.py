import csv
import io
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapf_pz.errors import FormatError
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.planners import Plan
from mapf_pz.planners.plans.files import PlanMetadata, Selection, format_plan, parse_plan, read_plan, write_plan
from mapf_pz.planners.plans.plan import reached
from tests.helpers.corrupt_files import near_misses

GRID = Grid(np.ones((3, 4), bool), "small")
STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0), (0, 0)])
TRACKER = 'agents,solution_cost,path\n2,3,"rr\nd"\n1,1,r\n'
SCENARIO = Scenario([[0, 0], [2, 3]], [[0, 2], [1, 3]])
TEXT = """agents=2
soc=3
makespan=2
starts=(0,0),(3,2),
goals=(2,0),(3,1),
solution=
0:(0,0),(3,2),
1:(1,0),(3,1),
2:(2,0),(3,1),
"""
LORR = {
    "actionModel": "MAPF_T",
    "teamSize": 2,
    "start": [[0, 0, "E"], [2, 3, "N"]],
    "numTaskFinished": 1,
    "sumOfCost": 6,
    "makespan": 3,
    "actualPaths": ["F,F,W", "F,C,W"],
    "events": [[[0, 0, "assigned"], [0, 2, "finished"], [2, 2, "assigned"]], [[1, 0, "assigned"]]],
    "tasks": [[0, 0, 2], [1, 0, 0], [2, 1, 1]],
}
LORR_2024 = LORR | {
    "version": "2024 LoRR",
    "actualSchedule": ["1:0,3:-1", "1:1"],
    "tasks": [[0, 0, [0, 1, 0, 2]], [1, 0, [1, 3, 0, 3]]],
    "events": [[1, 0, 0, 1], [1, 1, 1, 1], [2, 0, 0, 2]],
}


def lorr(**changes):
    return json.dumps(LORR | changes)


def message_of(text, selection=None):
    with pytest.raises(FormatError) as caught:
        parse_plan(text, "p", selection)
    message = str(caught.value)
    assert "\n" not in message
    return message


def any_plan(draw, turning):
    """Sample a plan on the grid, in which agents may collide."""
    num_agents, num_steps = draw(st.integers(1, 4)), draw(st.integers(0, 9))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    cells = np.empty((num_steps + 1, num_agents, 2), np.int64)
    cells[0] = np.argwhere(GRID.free)[rng.choice(12, num_agents, replace=False)]
    headings = np.zeros((num_steps + 1, num_agents), np.int64)
    headings[0] = rng.integers(4, size=num_agents)
    for step in range(num_steps):
        directions = headings[step] if turning else rng.integers(5, size=num_agents)
        turns = rng.choice([-1, 0, 0, 0, 1], num_agents) if turning else np.zeros(num_agents, int)
        ahead = np.clip(cells[step] + STEPS[directions], 0, np.array(GRID.shape) - 1)
        cells[step + 1] = np.where((turns == 0)[:, None], ahead, cells[step])
        headings[step + 1] = (headings[step] + turns) % 4
    return Plan(cells, headings if turning else None)


@st.composite
def plans(draw, turning=None, lifelong=False):
    """Sample a plan, and an instance with its starts."""
    plan = any_plan(draw, draw(st.booleans()) if turning is None else turning)
    goals = np.array(draw(st.lists(st.sampled_from(np.argwhere(GRID.free).tolist()), min_size=2, max_size=3)))
    goals = np.tile(goals, (plan.num_agents, 1, 1)) if lifelong else plan.positions[-1]
    return plan, Instance(GRID, Scenario(plan.positions[0], goals), None if plan.headings is None else plan.headings[0])


def assert_same(plan, expected):
    assert np.array_equal(plan.positions, expected.positions)
    assert (plan.headings is None) == (expected.headings is None)
    assert plan.headings is None or np.array_equal(plan.headings, expected.headings)


# Round trips.


@given(plans())
def test_text_round_trip(drawn):
    plan, instance = drawn
    text = format_plan(plan, "a.txt", instance, PlanMetadata("", "some solver", 1.5))
    file = parse_plan(text, "a.txt")
    assert_same(file.plan, plan)
    assert np.array_equal(file.goals, instance.scenario.goals)
    assert file.claims == {"sum of costs": plan.sum_of_costs, "makespan": plan.makespan}
    assert "solver=some solver\nsolved=1\n" in text
    assert "comp_time=1500\n" in text


@given(plans())
def test_lorr_round_trip(drawn):
    plan, instance = drawn
    file = parse_plan(format_plan(plan, "a.json", instance), "a.json")
    assert_same(file.plan, plan)
    assert np.array_equal(file.goals, instance.scenario.goals)
    costs = {"sum of costs": plan.sum_of_costs, "makespan": plan.makespan}
    assert file.claims == costs | {"tasks finished": plan.num_agents}


@given(plans(lifelong=True))
def test_lifelong_lorr_round_trip(drawn):
    plan, instance = drawn
    file = parse_plan(format_plan(plan, "a.json", instance), "a.json")
    assert_same(file.plan, plan)
    costs = {"sum of costs": plan.num_steps * plan.num_agents, "makespan": plan.num_steps}
    assert file.claims == costs | {"tasks finished": file.schedule.finished(plan)}


@given(plans(turning=False))
def test_tracker_round_trip(drawn):
    """Waits at the end are not written."""
    plan, instance = drawn
    text = format_plan(plan, "a.csv", instance, PlanMetadata("some-map-even-7"))
    file = parse_plan(text, "a.csv", Selection(instance.scenario, plan.num_agents, "small-even-7"))
    away = np.flatnonzero((plan.positions != plan.positions[-1]).any(axis=(1, 2)))
    assert_same(file.plan, Plan(plan.positions[: away.max(initial=-1) + 2]))
    assert file.claims == {"sum of costs": plan.sum_of_costs}


def test_files(tmp_path):
    plan = Plan(np.array([[(0, 0)], [(0, 1)]]))
    instance = Instance(GRID, Scenario([[0, 0]], [[0, 1]]))
    for name in ("a.json", "a.TXT", "a.csv"):
        write_plan(plan, tmp_path / name, instance)
        assert_same(read_plan(tmp_path / name, Selection(instance.scenario)).plan, plan)
    with pytest.raises(ValueError, match=r"a\.svg: expected a file name that ends in \.json, \.csv, \.txt$"):
        write_plan(plan, tmp_path / "a.svg", instance)
    with pytest.raises(FileNotFoundError, match=r"b\.json: no such file"):
        read_plan(tmp_path / "b.json")


def test_what_is_written():
    plan = Plan(np.array([[(0, 0), (2, 3)], [(1, 0), (2, 3)], [(0, 0), (2, 2)]]))
    instance = Instance(GRID, Scenario(plan.positions[0], plan.positions[-1]))
    record = json.loads(format_plan(plan, "a.json", instance))
    assert record == {
        "actionModel": "MAPF",
        "AllValid": "Yes",
        "teamSize": 2,
        "start": [[0, 0, "N/A"], [2, 3, "N/A"]],
        "numTaskFinished": 2,
        "sumOfCost": 4,
        "makespan": 2,
        "actualPaths": ["D,U", "W,L"],
        "plannerPaths": ["D,U", "W,L"],
        "plannerTimes": [],
        "errors": [],
        "events": [[[0, 0, "assigned"], [0, 2, "finished"]], [[1, 0, "assigned"], [1, 2, "finished"]]],
        "tasks": [[0, 0, 0], [1, 2, 2]],
    }
    table = format_plan(plan, "a.csv", instance, PlanMetadata("small-random-3"))
    assert table == (
        "map_name,scen_type,type_id,agents,lower_cost,solution_cost,solution_plan\n"
        'small,random,3,2,,4,"ud\nwl"\n'
    )  # fmt: skip


def test_unwritable_plans_are_rejected():
    lifelong = Instance(GRID, Scenario([[0, 0]], [[[0, 0], [0, 1]]]))
    still = Plan(np.zeros((1, 1, 2)))
    for ending in ("csv", "txt"):
        with pytest.raises(ValueError, match="one goal for each agent, but this instance has several"):
            format_plan(still, f"a.{ending}", lifelong)
    turning = Plan(np.zeros((1, 1, 2)), np.zeros((1, 1)))
    with pytest.raises(ValueError, match=r"a\.csv: a tracker CSV file cannot hold headings"):
        format_plan(turning, "a.csv", lifelong)
    jump = Plan(np.array([[(0, 0)], [(0, 2)]]))
    with pytest.raises(ValueError, match="plan: step 1 of agent 0 is not a valid step, so it cannot be written"):
        format_plan(jump, "a.json", lifelong)
    comma = Instance(Grid(GRID.free, "a,b"), Scenario([[0, 0]], [[0, 1]]))
    with pytest.raises(ValueError, match="map name 'a,b': a tracker CSV file cannot hold this name"):
        format_plan(still, "a.csv", comma)
    with pytest.raises(ValueError, match="plan: 2 agents, but the instance has 1"):
        format_plan(Plan(np.zeros((1, 2, 2))), "a.json", lifelong)


# Text.


def test_text():
    file = parse_plan(TEXT, "p")
    assert file.plan.positions.tolist() == [[[0, 0], [2, 3]], [[0, 1], [1, 3]], [[0, 2], [1, 3]]]
    assert file.goals.tolist() == SCENARIO.goals.tolist()
    assert file.claims == {"sum of costs": 3, "makespan": 2}


def test_headings_in_a_text():
    """The example file of mapf-visualizer."""
    text = "0:(0,0,Y_MINUS),\n1:(0,0,X_PLUS),\n2:(1,0,X_PLUS),\n3:(1,0,Y_PLUS),\n4:(1,1,Y_PLUS),\n5:(1,1,X_PLUS),\n"
    file = parse_plan(text, "p")
    assert file.plan.positions[:, 0].tolist() == [[0, 0], [0, 0], [0, 1], [0, 1], [1, 1], [1, 1]]
    assert file.plan.headings[:, 0].tolist() == [3, 0, 0, 1, 1, 0]
    assert file.goals is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2:(2", "3:(2", "p:9: expected '2:' and cells, got '3:(2,0),(3,1),'"),
        ("2:(2", "2:[2", "p:9:3: expected a cell (x,y), got '[2,0),(3,1),'"),
        ("1:(1,0),", "1:", "p:8: expected 2 cells, with headings for all cells or for none"),
        ("1:(1,0),(3,1),", "1:", "p:8: expected cells (x,y), got none"),
        ("1:(1,0)", "1:(1,0,X_PLUS)", "p:8: expected 2 cells, with headings for all cells or for none"),
        ("0:(0,0)", "0:(0,0,X_PLUS)", "p:7: expected 2 cells, with headings for all cells or for none"),
        ("goals=(2,0),", "goals=", "p:5: expected 2 cells as goals, got 1"),
        ("starts=(0,0)", "starts=(1,0)", "p:4: expected the solution to start at the starts"),
        (TEXT[TEXT.index("0:") :], "", "p: expected a solution, got none"),
    ],
)
def test_malformed_texts(old, new, message):
    assert old in TEXT
    assert message_of(TEXT.replace(old, new, 1)) == message


# The tracker's CSV.


@pytest.mark.parametrize("text", [TRACKER, TRACKER.replace("\n", "\r\n"), TRACKER.rstrip("\n")])
def test_tracker(text):
    file = parse_plan(text, "p", Selection(SCENARIO, 2))
    assert file.plan.positions.tolist() == [[[0, 0], [2, 3]], [[0, 1], [1, 3]], [[0, 2], [1, 3]]]
    assert file.claims == {"sum of costs": 3}
    assert parse_plan(text, "p", Selection(SCENARIO, 1)).plan.num_steps == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("agents,", "agent,", "p:1: expected the columns agents and solution_plan or path"),
        ("2,3,", "two,3,", "p:2: expected the number of agents, got 'two'"),
        ("2,3,", "2,3,4,", "p:2: expected 3 fields, got 4"),
        ("2,3,", "5,3,", "p: expected one plan for 2 agents, got 0: the file has plans for 5, 1"),
        ("1,1,r", "2,1,r", "p: expected one plan for 2 agents, got 2: the file has plans for 2, 2"),
        ("rr\n", "", "p:2: expected a line for each of 2 agents, got 1"),
        ("\nd", "\nd.", "p:3: expected one of udlrw as step 2 of agent 1, got '.'"),
        ('d"', "d", "p:2: expected a quoted field, or a field without quotes in it"),
    ],
)
def test_malformed_trackers(old, new, message):
    assert old in TRACKER
    assert message_of(TRACKER.replace(old, new, 1), Selection(SCENARIO, 2)) == message


def test_a_tracker_needs_the_scenario():
    assert "expected a scenario to be given" in message_of(TRACKER)
    small = Scenario(SCENARIO.starts[:1], SCENARIO.goals[:1])
    assert message_of(TRACKER, Selection(small, 2)) == "p:2: expected a scenario of 2 agents, got 1"


def test_a_plan_is_selected_by_the_scenario():
    rows = "".join(f"m,even,{number},1,,1,{letter}\n" for number, letter in ((1, "r"), (2, "d")))
    text = f"map_name,scen_type,type_id,agents,lower_cost,solution_cost,solution_plan\n{rows}"
    assert parse_plan(text, "p", Selection(SCENARIO, 1, "m-even-2")).plan.positions[1].tolist() == [[-1, 0]]
    expected = "p: expected one plan of m-even-3, got 0: the file has plans for m-even-1 1, m-even-2 1"
    assert message_of(text, Selection(SCENARIO, None, "m-even-3")) == expected


def test_a_long_wait_of_many_agents_needs_no_memory():
    text = f'agents,path\n20000,"{"w" * 20_000}{chr(10) * 19_999}"\n'
    many = Scenario(np.zeros((20_000, 2)), np.zeros((20_000, 2)))
    expected = "p:2: expected at most 50000000 steps times agents, got 20000 steps of 20000 agents"
    assert message_of(text, Selection(many)) == expected


# The League of Robot Runners.


def test_lorr_of_2023():
    file = parse_plan(lorr(), "p")
    assert file.plan.positions[:, 0].tolist() == [[0, 0], [0, 1], [0, 2], [0, 2]]
    assert file.plan.positions[:, 1].tolist() == [[2, 3], [1, 3], [1, 3], [1, 3]]
    assert file.plan.headings[:, 1].tolist() == [3, 3, 2, 2]
    assert file.claims == {"sum of costs": 6, "makespan": 3, "tasks finished": 1}
    assert file.schedule.finished(file.plan) == 1
    assert file.goals is None


def test_lorr_of_2024():
    file = parse_plan(json.dumps(LORR_2024), "p")
    assert file.schedule.assigned == (((1, 0), (3, -1)), ((1, 1),))
    assert file.schedule.finished(file.plan) == 1
    tasks = {0: np.array([[0, 2]]), 1: np.array([[1, 3]])}
    assert file.schedule.finished(file.plan, tasks.__getitem__) == 2


def test_lorr_of_2026():
    ticks = ["[(0,0,0,0,0):(F 2,W 1)][(3,0,0,0,0):(F 1,R 3)]", "[(0,0,0,0,0):(W 2,C 3,W 1,F 1)]"]
    plan = parse_plan(lorr(version="2026 LoRR", agentMaxCounter=3, actualPaths=ticks), "p").plan
    assert plan.num_steps == 7
    assert plan.positions[:, 0, 1].tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert plan.headings[:, 1].tolist() == [3, 3, 3, 3, 3, 2, 2, 2]


def test_a_summary_without_tasks():
    data = {name: LORR[name] for name in ("actionModel", "teamSize", "start", "actualPaths")}
    file = parse_plan(json.dumps(data), "p")
    assert (file.schedule, file.goals, file.claims) == (None, None, {})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actionModel": "MAPF_X"}, "expected 'actionModel' MAPF or MAPF_T, got 'MAPF_X'"),
        ({"actionModel": {}}, "expected 'actionModel' MAPF or MAPF_T, got {}"),
        ({"teamSize": 3}, "expected 3 items in 'start', got 2"),
        ({"teamSize": "2"}, "expected 'teamSize' to be a whole number, 1 or more, got '2'"),
        (
            {"start": [[0, 0, "E"]] * 2 + [[]], "teamSize": 3},
            "expected the start of agent 2 to be [row, col, E or S or",
        ),
        ({"start": [[0, -1, "E"]] * 2}, "expected the start of agent 0 to be [row, col, E or S or W or N], got [0, -1"),
        ({"start": [[0, 0, "N/A"]] * 2}, "expected the start of agent 0 to be [row, col, E or S or W or N], got [0, 0"),
        ({"start": [[0, 2**40, "E"]] * 2}, "expected the start of agent 0 to be [row, col, E or S or W or N], got [0"),
        ({"actualPaths": ["F,F,W"]}, "expected 2 items in 'actualPaths', got 1"),
        ({"actualPaths": ["F,F,W", 7]}, "expected the path of agent 1 to be text, got 7"),
        ({"actualPaths": ["F,F,W", "F,C"]}, "expected 3 steps for agent 1, as for agent 0, got 2"),
        ({"actualPaths": ["F,U,W", "F,C,W"]}, "expected one of FRCW as step 2 of agent 0, got 'U'"),
        ({"actualPaths": ["F,F,W", "F,C,"]}, "expected one of FRCW as step 3 of agent 1, got ''"),
        ({"actualPaths": ["F,F,W", "FCW,"]}, "expected one of FRCW as step 1 of agent 1, got 'FCW'"),
        ({"events": [[]]}, "expected 2 items in 'events', got 1"),
        (
            {"events": [[], [[0, 1, "started"]]]},
            "expected events of agent 1 to be [task, step, assigned or finished], go",
        ),
        (
            {"events": [[], [[0, 5, "assigned"], [1, 2, "assigned"]]]},
            "expected the tasks of agent 1 in chronological or",
        ),
        ({"tasks": [[0, 1]]}, "expected a task [task, row, col] or [task, step, [row, col, ...]], got [0, 1]"),
        (
            {"tasks": [[0, 1, [2, 3, 4]]]},
            "expected a task [task, row, col] or [task, step, [row, col, ...]], got [0, 1",
        ),
        ({"tasks": 5}, "expected 'tasks' to be a list, got 5"),
        (LORR_2024 | {"actualSchedule": ["1:0", "1;1"]}, "expected the schedule of agent 1 to be 'step:task,...', got"),
        (
            LORR_2024 | {"actualSchedule": [None, ""]},
            "expected the schedule of agent 0 to be 'step:task,...', got None",
        ),
    ],
)
def test_malformed_lorr(changes, message):
    assert message_of(lorr(**changes)).startswith(f"p: {message}")


@pytest.mark.parametrize(
    "changes", [{"events": [], "tasks": []}, {"events": []}, LORR_2024 | {"actualSchedule": [], "tasks": []}]
)
def test_an_empty_schedule_is_none(changes):
    """Paths are complete without it."""
    name = "events" if "version" not in changes else "actualSchedule"
    without = {key: value for key, value in (LORR | changes).items() if key not in (name, "tasks")}
    found, expected = parse_plan(lorr(**changes), "p"), parse_plan(json.dumps(without), "p")
    assert found.schedule is expected.schedule is None
    assert np.array_equal(found.plan.positions, expected.plan.positions)
    assert found.claims == expected.claims == {"sum of costs": 6, "makespan": 3, "tasks finished": 1}


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("[(0,0,0,0,0):(F 2,W 1", "p: expected a segment '[(0,row,col,heading,counter):(F 10,...)]' in the path"),
        ("[(0,0,0,0,0):(F 2)][(3,0,0,0,0):(W 1)]", "p: expected a segment '[(2,row,col,heading,counter):(F 10,...)]'"),
        ("[(0,0,0,0,0):(F 2,X 1)]", "p: expected a letter and ticks such as 'F 10' in the path of agent 0, character"),
        ("[(0,0,0,0,0):(F 2,R 1)]", "p: expected agent 0 to finish the action F before R, at tick 2"),
        ("[(0,0,0,0,0):(W 999999999)]", "p: expected at most 50000000 steps times agents, got 999999999 steps of 2"),
    ],
)  # fmt: skip
def test_malformed_ticks(path, message):
    assert message_of(lorr(agentMaxCounter=3, actualPaths=[path, path])).startswith(message)


def test_ticks_of_agents_that_do_not_turn():
    path = "[(0,0,0,0,0):(F 2)]"
    expected = "p: expected the model MAPF_T for paths in ticks, got MAPF"
    text = lorr(actionModel="MAPF", start=[[0, 0, "N/A"]] * 2, agentMaxCounter=3, actualPaths=[path, path])
    assert message_of(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("agents,path\n" + "1,r\n" * 100_001, "p:100002: expected at most 100000 plans"),
        ("agents,path" + ",a" * 99 + "\n", "p:1: expected at most 100 fields"),
        ("".join(f"a{n}=\n" for n in range(1001)), "p:1001: expected a header of at most 1000 entries"),
    ],
)
def test_size_limits(text, message):
    assert message_of(text, Selection(SCENARIO)) == message


def test_hostile_json(monkeypatch):
    assert message_of("{").startswith("p:1:2: expected JSON: ")
    assert message_of('{"a": ' + "[" * 50_000) == "p: expected JSON that is not nested deeply"
    monkeypatch.setattr("mapf_pz._internal.json.MAX_LISTS", 5)
    assert message_of(lorr()) == "p: expected at most 5 lists and objects"


def test_a_schedule_of_other_agents():
    schedule, plan = parse_plan(lorr(), "p").schedule, Plan(np.zeros((2, 3, 2)))
    with pytest.raises(ValueError, match="schedule: expected 3 agents, got 2"):
        schedule.finished(plan)


def test_an_assigned_task_that_the_file_lacks():
    file = parse_plan(lorr(tasks=[]), "p")
    with pytest.raises(ValueError, match="schedule: task 0 is not among the file's tasks"):
        file.schedule.finished(file.plan)


# Several goals in order.


def test_goals_are_counted_from_the_step_after_the_previous_one():
    path = np.array([(0, 0), (0, 0), (0, 1), (0, 1), (0, 0)])
    assert reached(path, np.array([(0, 0), (0, 1), (0, 1), (0, 0), (0, 0)])) == [1, 2, 3, 4]
    assert reached(path, np.array([(0, 1), (5, 5), (0, 0)])) == [2]
    assert reached(path[:1], np.array([(0, 0)])) == []


# Any text.


TICKS = lorr(version="2026 LoRR", agentMaxCounter=3, actualPaths=["[(0,0,0,0,0):(F 2,W 1)][(3,0,0,0,0):(F 3)]"] * 2)


SEPARATORS = '\n"09,:[]('


@given(
    st.text()
    | st.one_of([near_misses(text, SEPARATORS) for text in (TEXT, TRACKER, lorr(), json.dumps(LORR_2024), TICKS)])
)
def test_any_text_is_a_plan_or_a_format_error(text):
    try:
        file = parse_plan(text, "p", Selection(SCENARIO, 2))
    except FormatError as error:
        assert "\n" not in str(error)  # noqa: PT017 (most texts, but not all, are rejected)
        return
    if file.schedule is not None:
        try:
            file.schedule.finished(file.plan)
        except ValueError as error:
            assert "is not among the file's tasks" in str(error)  # noqa: PT017


@pytest.mark.parametrize(("ending", "cost"), [("csv", "solution_cost"), ("txt", "soc")])
def test_agents_that_never_move_cost_nothing_in_formats_that_say_so(ending, cost):
    grid = Grid(np.ones((2, 3), np.bool_), "small")
    scenario = Scenario(np.array([[0, 0], [1, 0]]), np.array([[0, 0], [1, 2]]))
    plan = Plan(np.array([[[0, 0], [1, 0]], [[0, 0], [1, 1]], [[0, 0], [1, 2]]]))
    text = format_plan(plan, f"a.{ending}", Instance(grid, scenario), PlanMetadata(lower_bound=3))
    if ending == "csv":
        (row,) = csv.DictReader(io.StringIO(text))
        assert (row["solution_cost"], row["lower_cost"]) == ("2", "2")
    else:
        assert "\nsoc=2\n" in text
    file = parse_plan(text, f"a.{ending}", Selection(scenario, 2))
    assert file.claims["sum of costs"] == file.plan.sum_of_costs == 3
