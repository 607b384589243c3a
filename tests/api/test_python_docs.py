"""Every example of docs/python.md runs, in its order, and the notebook finds what it says."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from replayed_drive import log

from paths import ROOT, SHARED_DATA
from test_docs import blocks

PAGE = ROOT / "docs" / "python.md"
NOTEBOOK = ROOT / "docs" / "first_drive.ipynb"


@pytest.mark.slow
def test_every_example_of_the_page_runs(tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "logs"
    folder.mkdir()
    for path in (tmp_path / "drive.log", folder / "a.log", folder / "b.log"):
        path.write_bytes(log().read_bytes())
    names: dict[str, object] = {}
    examples = blocks(PAGE, "python")
    assert len(examples) > 8
    for number, text in enumerate(examples):
        exec(compile(text, f"{PAGE.name} example {number}", "exec"), names)
    assert names["frame"].attrs["units"]["accel_x_mps2"] == "m/s^2"  # type: ignore[attr-defined]
    assert names["joined"].num_rows > 1000  # type: ignore[attr-defined]
    assert names["again"].to_dict() == names["drive"].to_dict()  # type: ignore[attr-defined]
    assert 1.0 < names["peak"] < 12.0  # type: ignore[operator]
    assert len(names["drives"]) == 2  # type: ignore[arg-type]
    assert Path("mount.png").stat().st_size > 5000
    assert Path("long.accel.parquet").exists()


@pytest.mark.slow
def test_the_notebook_runs_and_its_figures_hold():
    """The notebook's own assertions judge its figures."""
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "keep it without outputs"
    os.environ.setdefault("PYTHONPATH", str(ROOT / "daemon"))
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": ROOT}})
    client.execute()
    shown = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    html = "".join(o["data"].get("text/html", "") for o in shown if "data" in o)
    assert "waiting for" in html, "the drive is shown as a table"
    assert any("image/png" in o.get("data", {}) for o in shown)
    printed = "".join(o["text"] for o in shown if o["output_type"] == "stream")
    assert ("from the INS's" in printed) == (SHARED_DATA / "kingston_2008").exists()
