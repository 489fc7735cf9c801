"""Run the notebooks and keep what they show: `python tests/notebooks/refresh.py [NAME...]`, or `make notebooks`.

The plain Python text beside each notebook is its source; the .ipynb is that text with outputs, for reading. What
depends on the machine or the hour is taken out, and pictures are stored with few colours: the files stay small.
"""

import base64
import io
import os
import re
import sys
import time
from pathlib import Path
from typing import Any

import jupytext
import nbclient
import nbformat

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
LONGEST = 120  # [s] that a notebook may take on two cores
LARGEST = 700_000  # bytes of a notebook with its outputs
_COLOURS = 256  # of a stored picture
_MACHINE = re.compile(
    r"(/(?:home|root|tmp|work|usr|opt|Users|mnt|var)/|[A-Z]:\\|site-packages|https?://[\w.:-]*(?:pypi|proxy))"
)


def sources() -> list[Path]:
    """The plain texts of all notebooks."""
    return sorted(FOLDER.glob("*.py"))


def executed(source: Path) -> nbformat.NotebookNode:
    """A notebook run from its first to its last cell, from the notebooks' own folder, as a user's Jupyter does.

    Raises:
        CellExecutionError: a cell failed.
    """
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
    notebook = jupytext.read(source)
    resources = {"metadata": {"path": str(FOLDER)}}
    nbclient.NotebookClient(notebook, timeout=4 * LONGEST, resources=resources, record_timing=False).execute()
    return cleaned(notebook)


def cleaned(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """The notebook without what changes from run to run or from machine to machine."""
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number:02d}"
        cell.metadata.pop("execution", None)
        if "outputs" in cell:
            cell.outputs = _whole_streams(cell.outputs)
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = few_colours(data["image/png"])
                data["text/plain"] = "a figure"
                output["metadata"] = {}
    notebook.metadata.pop("widgets", None)
    notebook.metadata.get("language_info", {}).pop("version", None)
    return notebook


def _whole_streams(outputs: list[Any]) -> list[Any]:
    """Text that came in several pieces, by chance, as one."""
    whole: list[Any] = []
    for output in outputs:
        if whole and output.output_type == "stream" == whole[-1].output_type and output.name == whole[-1].name:
            whole[-1].text += output.text
        else:
            whole.append(output)
    return whole


def few_colours(png: str) -> str:
    """A picture in base64 with a palette of its own: a third of the size, and nothing that an eye would miss."""
    from PIL import Image

    content = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(png))) as picture:
        # Of large areas and of small ones: a red ball on green grass stays red.
        rgb = picture.convert("RGB")
        small = rgb.quantize(_COLOURS, kmeans=2, dither=Image.Dither.NONE)
        small.save(content, "PNG", optimize=True)
    return base64.b64encode(content.getvalue()).decode()


def complaints(notebook: nbformat.NotebookNode) -> list[str]:
    """What a stored notebook must not show: errors, warnings, anything of the machine it ran on."""
    found = []
    for number, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", []):
            if output.output_type == "error" or output.get("name") == "stderr":
                found.append(f"cell {number}: {output.get('text', output.get('evalue', ''))[:200]}")
            if match := _MACHINE.search(_text(output)):
                found.append(f"cell {number} shows '{match.group()}'")
    return found


def _text(output: Any) -> str:
    data = output.get("data", {})
    return "\n".join(
        str(one) for one in (output.get("text", ""), *(data[kind] for kind in data if "image" not in kind))
    )


def main(names: list[str]) -> int:
    """Run notebooks and store them; tell how long each took and how large it is."""
    worst = 0
    for source in [one for one in sources() if not names or one.stem in names]:
        began, spent = time.monotonic(), os.times()
        notebook = executed(source)
        used = sum(os.times()[2:4]) - sum(spent[2:4])
        target = source.with_suffix(".ipynb")
        text = nbformat.writes(notebook)
        target.write_text(text if text.endswith("\n") else text + "\n", encoding="utf-8")
        size = target.stat().st_size
        print(f"{source.stem}: {time.monotonic() - began:.0f} s, {used:.0f} s of processor time, {size / 1000:.0f} kB")
        for line in complaints(notebook) + ([f"larger than {LARGEST / 1000:.0f} kB"] if size > LARGEST else []):
            worst = 1
            print(f"  {line}", file=sys.stderr)
    return worst


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
