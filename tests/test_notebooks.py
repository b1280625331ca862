"""The notebooks run, without Jupyter, and hold no outputs."""

import ast
import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[1] / "examples" / "notebooks"
METHODS = ("_repr_html_", "_repr_png_")
"""The methods by which Jupyter displays recordings and images."""
DISPLAYED = {"environment": ["_repr_html_"], "train": ["_repr_png_", "_repr_html_"], "evaluate": ["_repr_png_"]}
"""The methods of the values that each notebook displays, in the order of its cells."""


BUDGET = "agent_steps=20_000"
"""Length of training runs here, whatever that of a notebook is."""


def code_cells(name):
    notebook = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text("utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(code, namespace):
    """Run a cell; return the value of its last statement if that is an expression, as Jupyter displays it."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), namespace)
    return None if last is None else eval(compile(ast.Expression(last.value), "<cell>", "eval"), namespace)


def test_all_notebooks_are_run():
    assert {file.stem for file in NOTEBOOKS.glob("*.ipynb")} == DISPLAYED.keys()


@pytest.mark.parametrize("name", ["environment", pytest.param("train", marks=pytest.mark.slow), "evaluate"])
def test_notebook(name, tmp_path, monkeypatch, capsys):
    if name != "environment":
        pytest.importorskip("torchrl")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    sources = [re.sub(r"agent_steps=[\d_]+", BUDGET, "".join(cell["source"])) for cell in code_cells(name)]
    assert (BUDGET in "".join(sources)) == (name == "train")
    values = [run(source, namespace) for source in sources]
    displayed = [(method, value) for value in values for method in METHODS if hasattr(value, method)]
    assert [method for method, _ in displayed] == DISPLAYED[name]
    assert all(getattr(value, method)() for method, value in displayed)
    assert name == "environment" or "| pibt |" in capsys.readouterr().out


@pytest.mark.parametrize("name", DISPLAYED)
def test_no_outputs_are_stored(name):
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code_cells(name))
