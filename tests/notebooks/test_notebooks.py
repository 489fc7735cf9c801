"""Every notebook runs from its plain Python text to its last cell, and what is stored of it is that text, and clean."""

import ast
import importlib.util
import json
from pathlib import Path

import pytest

jupytext, nbformat, *_ = (
    pytest.importorskip(name, reason="the notebooks extra is not installed")
    for name in ("jupytext", "nbformat", "nbclient", "matplotlib", "PIL")
)

_spec = importlib.util.spec_from_file_location("refresh", Path(__file__).with_name("refresh.py"))
refresh = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(refresh)

SOURCES = refresh.sources()
LONGEST_FUNCTION = 25  # lines: no longer than a plot
every_notebook = pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)


def test_all_four_are_there():
    """Those that the documentation links to."""
    names = {"look_at_a_log", "judge_a_fit", "simulated_over_measured", "watch_a_policy"}
    assert {path.stem for path in SOURCES} == names
    assert {path.stem for path in refresh.FOLDER.glob("*.ipynb")} == names


@every_notebook
def test_runs(source):
    """A notebook runs without an error and shows pictures, and nothing of the machine it runs on."""
    notebook = refresh.executed(source)
    assert refresh.complaints(notebook) == []
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in shown) >= 4
    stored = nbformat.read(source.with_suffix(".ipynb"), as_version=4)
    kinds = [[output.output_type for output in cell.get("outputs", [])] for cell in notebook.cells]
    assert kinds == [[output.output_type for output in cell.get("outputs", [])] for cell in stored.cells]


@every_notebook
def test_what_is_stored_is_the_source(source):
    """The .ipynb holds the same cells as the .py beside it: neither is edited alone (`make notebooks`)."""
    stored, text = nbformat.read(source.with_suffix(".ipynb"), as_version=4), jupytext.read(source)
    assert [(cell.cell_type, cell.source) for cell in stored.cells] == [
        (cell.cell_type, cell.source) for cell in text.cells
    ]


@every_notebook
def test_what_is_stored_is_clean_and_small(source):
    """It was run from the first cell to the last; no errors, warnings, paths or times; a page loads it at once."""
    path = source.with_suffix(".ipynb")
    stored = nbformat.read(path, as_version=4)
    nbformat.validate(stored)
    assert refresh.complaints(stored) == []
    assert path.stat().st_size < refresh.LARGEST
    assert "execution" not in {key for cell in stored.cells for key in cell.metadata}
    counts = [cell.execution_count for cell in stored.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    assert "version" not in json.loads(path.read_text())["metadata"].get("language_info", {})


@every_notebook
def test_stays_readable(source):
    """No function is longer than a plot, no cell longer than a screen, and there is text to read."""
    tree = ast.parse(source.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno - node.lineno < LONGEST_FUNCTION, node.name
    notebook = jupytext.read(source)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            lines = [line for line in cell.source.splitlines() if not line.startswith(("import ", "from "))]
            assert len(lines) <= LONGEST_FUNCTION, cell.source
    words = sum(len(cell.source.split()) for cell in notebook.cells if cell.cell_type == "markdown")
    assert words > 300


def test_complaints_are_found():
    """Warnings, errors and paths of a machine are seen where they stand."""
    made = nbformat.v4.new_notebook(
        cells=[
            nbformat.v4.new_code_cell(outputs=[nbformat.v4.new_output("stream", name="stderr", text="careful")]),
            nbformat.v4.new_code_cell(outputs=[nbformat.v4.new_output("stream", name="stdout", text="at /home/me/x")]),
            nbformat.v4.new_code_cell(
                outputs=[nbformat.v4.new_output("display_data", data={"text/html": "<a>/tmp/y.mcap</a>"})]
            ),
            nbformat.v4.new_code_cell(outputs=[nbformat.v4.new_output("error", ename="E", evalue="no", traceback=[])]),
            nbformat.v4.new_code_cell(outputs=[nbformat.v4.new_output("stream", name="stdout", text="runs/a.mcap")]),
        ]
    )
    assert [line.split(":")[0].split(" shows")[0] for line in refresh.complaints(made)] == [
        f"cell {number}" for number in range(4)
    ]
