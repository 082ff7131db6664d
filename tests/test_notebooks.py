"""Every notebook runs, in a short form, and computes what its text says (about 40 s)."""

import re
from pathlib import Path

import kfenv.agents
import nbformat
import pytest
from nbclient import NotebookClient
from rinex_files import BROADCAST, OBSERVED, needs_rinex

FOLDER = Path(__file__).parents[1] / "notebooks"

# What takes the place of a notebook's parameters, and what must be true in the end.
SHORT = {
    "first_look": (
        "RUNS = 4",
        "assert all(np.isfinite(s.rmse).all() for s in [*scores.values(), *traces.values()])\n"
        "assert np.nanmedian(nominal['nis'][inside]) > 10.0 * chi2.median(3)\n"
        "assert np.isfinite(replayed['estimate']).all()",
    ),
    "paper_reproduction": (
        "EXPERIMENTS, RUNS = ('E5',), 20",
        "assert {c['name']: c['verdict'] for c in claims}['C13 (E5)'] == 'holds'\n"
        "assert all(image.startswith(b'\\x89PNG') for image in figures.values())",
    ),
    "why_joseph_forms_differ": (
        "RUNS, RATES = 8, (2.0,)",
        # SPEC 2.3
        "assert np.allclose(radii[10.0], (1.0240, 0.9675), atol=2e-4)\n"
        "assert np.allclose(radii[2.0], (1.0906, 0.9198), atol=2e-4)\n"
        # SPEC 9
        "assert late_nees['without K Ω Kᵀ'] > 1.3 * late_nees['exact']\n"
        "assert difference < 1e-6\n"
        # SPEC 7.2, C9
        "assert eigenvalue['Jacobian at the posterior'].max() > 1.4\n"
        "assert np.mean(growth['Jacobian at the posterior'] > 1.0) > 0.5\n"
        "assert growth['sigma points, exact'].max() < 1.0 + 1e-9\n"
        "assert lost['SRUKF, Joseph, H at posterior'].any()\n"
        "assert not lost['SRUKF, Joseph exact'].any()\n"
        # SPEC 7.3
        "assert mismatch < 1e-9",
    ),
    "real_gps_log": (
        f"OBSERVATIONS, NAVIGATION = {str(OBSERVED)!r}, {str(BROADCAST)!r}\n"
        "EPISODES, TRIALS, AGENTS, JERKS = 2, 1, (), (1.0, 1e-8)",
        "assert np.all(np.abs(fix_error[known].mean(axis=0)) < (1.0, 1.0, 2.0))\n"
        "assert rms(errors['nominal']) < rms(errors['single-epoch fix'])\n"
        # the engine with the tuned setting is the tuned agent
        "again = engine(test, tuned['fixed-tuned'].values)\n"
        "again = np.sqrt(np.mean(np.sum(again**2, axis=2), axis=1))\n"
        "assert np.allclose(again, scores['fixed-tuned'].rmse, rtol=1e-6)\n"
        "assert best == 1e-8 and np.median(still) < np.median(scores['fixed'].rmse)\n"
        "assert excess < 0.5",
    ),
}
NEEDS = {"real_gps_log": needs_rinex}


def stored(name):
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def test_every_notebook_has_a_short_form():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(SHORT)


@pytest.mark.parametrize("name", SHORT)
def test_outputs_are_not_stored(name):
    cells = [cell for cell in stored(name).cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)


def test_the_reproduction_has_what_its_notebook_shows():
    """The short form runs one experiment; figures and claims of the others are looked up here."""
    folder = Path(kfenv.agents.__file__).with_name("reproduction")
    programs = "".join(path.read_text() for path in folder.glob("*.py"))
    cells = "\n".join(cell.source for cell in stored("paper_reproduction").cells)
    shown = set(re.findall(r'"(?:E\d|hard)/(\w+)"', cells))
    told = {
        name for names in re.findall(r"^tell\((\".+)\)", cells, re.M) for name in names.split(", ")
    }
    assert len(shown) > 5 and len(told) > 10
    for name in shown:
        stem = "rmse_difference_" if name.startswith("rmse_difference_") else f'{name}"'
        assert f'"{stem}' in programs, name
    for name in told:
        assert any(f"{name[:-1]}{end}" in programs for end in (" (", '"')), name


@pytest.mark.parametrize("name", [pytest.param(n, marks=NEEDS.get(n, ())) for n in SHORT])
def test_it_runs_and_computes_what_it_says(name, tmp_path, tmp_path_factory, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path_factory.mktemp("ipython")))
    notebook, (parameters, checks) = stored(name), SHORT[name]
    (place,) = [
        i for i, cell in enumerate(notebook.cells) if "parameters" in cell.metadata.get("tags", [])
    ]
    notebook.cells.insert(place + 1, nbformat.v4.new_code_cell(parameters))
    notebook.cells.append(nbformat.v4.new_code_cell(checks))
    resources = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=240, kernel_name="python3", resources=resources).execute()
    assert not list(tmp_path.iterdir())
