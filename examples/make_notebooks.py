"""Make the notebooks of the scripts that are written in cells: `python examples/make_notebooks.py`."""

import json
from pathlib import Path

SCRIPTS = ("swap_icp", "two_kinects")
HERE = Path(__file__).parent
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def notebook(script: str) -> str:
    """A notebook's file of a script whose cells begin with "# %%", those of text with "# %% [markdown]"."""
    cells = []
    for number, cell in enumerate(script.split("# %%")[1:]):
        kind, _, body = cell.partition("\n")
        is_text = kind.strip() == "[markdown]"
        lines = body.strip().splitlines(keepends=True)
        written = {"cell_type": "markdown" if is_text else "code", "id": f"cell-{number}", "metadata": {}}
        written["source"] = [line.removeprefix("#").removeprefix(" ") for line in lines] if is_text else lines
        if not is_text:
            written |= {"execution_count": None, "outputs": []}
        cells.append(written)
    content = {"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for name in SCRIPTS:
        text = (HERE / f"{name}.py").read_text(encoding="utf-8")
        (HERE / f"{name}.ipynb").write_text(notebook(text), encoding="utf-8")
