import pytest

from mapf_pz.commands.main import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of an evaluation of two policies."""
    folder = tmp_path_factory.mktemp("report") / "results"
    words = "--map empty-8-8 --num-agents 2 4 --episodes 3 --max-steps 20 --policy pibt --policy random"
    assert main(["evaluate", *words.split(), "--output", str(folder)]) == 0
    return folder


def test_a_table_on_the_screen_and_in_a_file(folder, tmp_path, capsys):
    assert main(["report", str(folder), "--columns", "CSR", "SoC (solved)"]) == 0
    header, _, *body = capsys.readouterr().out.splitlines()
    assert header == "| task | agents | policy | episodes | CSR | SoC (solved) |"
    assert [line.split(" | ")[1:4] for line in body] == [
        [agents, policy, "3"] for agents in ("2", "4") for policy in ("pibt", "random")
    ]
    words = ["--format", "latex", "--baseline", "pibt", "--output", str(tmp_path / "table.tex")]
    assert main(["report", str(folder), *words]) == 0
    assert capsys.readouterr().out == ""
    text = (tmp_path / "table.tex").read_text()
    assert text.startswith("\\begin{tabular}")
    assert "random" in text
    assert "pibt" not in text


def test_figures(folder, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert main(["report", str(folder), "--figures", str(tmp_path / "new" / "figures")]) == 0
    files = {file.name for file in (tmp_path / "new" / "figures").iterdir()}
    assert files == {"empty-8-8.pdf", "performance-profiles.pdf"}
    assert "figure written to " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--columns", "csr"], "columns ['csr']: expected some of 'CSR', 'ISR'"),
        (["--baseline", "lacam"], "baseline 'lacam': no such policy in the results, expected one of pibt, random"),
    ],
)
def test_errors(folder, words, error, capsys):
    assert main(["report", str(folder), *words]) == 1
    message = capsys.readouterr().err
    assert error in message
    assert message.count("\n") == 1


def test_a_folder_without_an_evaluation(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 1
    assert "expected the folder of an evaluation, with a file episodes.csv" in capsys.readouterr().err
