# SPDX-License-Identifier: Apache-2.0
"""The notebook of examples/ runs, cell by cell; run as a program this writes it anew.

Its cells are run as IPython would: what the last line of a cell gives is shown, and so are the figures. That
needs neither Jupyter nor nbclient.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "rig_story.ipynb"


def run_cell(code: str, space: dict[str, Any]) -> list[dict[str, Any]]:
    """The outputs of one cell, as a notebook holds them."""
    from matplotlib import pyplot

    tree, printed, shown = ast.parse(code), io.StringIO(), None
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), space)
        if last is not None:
            shown = eval(compile(ast.Expression(last.value), "cell", "eval"), space)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        text = printed.getvalue().splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": text})
    if hasattr(shown, "_repr_html_"):
        data = {"text/html": [shown._repr_html_()], "text/plain": [repr(shown)]}
        outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
    for number in pyplot.get_fignums():
        picture = io.BytesIO()
        pyplot.figure(number).savefig(picture, format="png", dpi=72, metadata={"Software": None})
        data = {"image/png": base64.b64encode(picture.getvalue()).decode()}
        outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
    pyplot.close("all")
    return outputs


def run_notebook() -> tuple[dict[str, Any], dict[str, Any]]:
    """The notebook with fresh outputs, and what its cells have defined."""
    content = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    space: dict[str, Any] = {}
    cells = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    for count, cell in enumerate(cells, start=1):
        cell["outputs"] = run_cell("".join(cell["source"]), space)
        cell["execution_count"] = count
    return content, space


def test_the_notebook_tells_the_story_that_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    content, space = run_notebook()
    assert space["found"].missing_effects == ["slip_sinkage"]
    assert space["added"].recommended
    assert (tmp_path / "model.yaml").exists()
    lines = [line for cell in content["cells"] if cell["cell_type"] == "code"
             for line in cell["source"] if line.strip()]  # fmt: skip
    assert len(lines) <= 15
    shown = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    for cell, before in zip(content["cells"], shown["cells"], strict=True):
        kinds = [
            [sorted(o.get("data", ["text"])) for o in c.get("outputs", [])] for c in (cell, before)
        ]
        assert kinds[0] == kinds[1]  # it is shown as it runs


def main() -> None:
    """Write the notebook with its outputs."""
    os.environ["MPLBACKEND"] = "Agg"
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        content, _ = run_notebook()
    NOTEBOOK.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(NOTEBOOK)


if __name__ == "__main__":
    sys.exit(main())
