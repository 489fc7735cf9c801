"""Every notebook runs from its plain Python text to its last cell."""

from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "notebooks").glob("*.py"))


@pytest.mark.parametrize("source", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs(source, monkeypatch):
    """A notebook runs without an error from the notebooks' own folder."""
    jupytext = pytest.importorskip("jupytext", reason="the notebooks extra is not installed")
    nbclient = pytest.importorskip("nbclient", reason="the notebooks extra is not installed")
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    notebook = jupytext.read(source)
    client = nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(source.parent)}})
    client.execute()
    images = [
        output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})
    ]
    assert images, "the notebook shows no picture"
