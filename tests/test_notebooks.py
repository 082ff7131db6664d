"""Every notebook runs, in a short form, and computes what its text says (about 40 s)."""

import re
from pathlib import Path

import kfenv.agents
import nbformat
import pytest
from jupyter_client.manager import start_new_kernel
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
    "when_fading_helps": (
        "RUNS, RATE, DURATION = 4, 10.0, 26.0",
        # SPEC 6
        "assert np.isclose(at_20['plain'], 0.5) and np.isclose(at_20['fading'], 0.998, atol=1e-3)\n"
        "assert at_20['Gaussian sum, fading, robust V'] < 0.01\n"
        "assert np.isclose(memory, 2.9, atol=0.15)\n"
        "assert 0.42 < idle[1.0] < 0.45 and idle[3.0] < 0.04\n"
        "assert np.isclose(raw[1000.0], 50105.0) and np.isclose(right[1000.0], 105.0)\n"
        "assert status[0] == 4\n"
        # what the text says
        "assert lasting['a jump of 4']['GSACKF'] < lasting['a jump of 4']['GSCKF']\n"
        "assert lasting['a jump of 30']['ACKF'] < 3 < lasting['a jump of 30']['GSACKF']\n"
        "assert speed['outliers', 'GSCKF'] < speed['outliers', 'GSACKF'] < 2.0\n"
        "assert speed['outliers', 'CKF'] < speed['outliers', 'ACKF']\n"
        "assert speed['unit fault', 'ACKF'] < 0.5 * speed['unit fault', 'CKF']\n"
        "assert speed['unit fault', 'GSCKF'] > speed['unit fault', 'CKF']\n"
        "others = [speed['both', m.label] for m in METHODS if m.label != 'GSACKF']\n"
        "assert speed['both', 'GSACKF'] < 0.5 * min(others)\n"
        "assert telling['unit fault'] > 0.5 > 0.3 > abs(telling['outliers'])",
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
    "your_own_filter": (
        "TRIALS, EPISODES, DURATION = 1, 6, 500.0",
        "error = {r['agent']: r['rmse_geometric_mean'] for r in results}\n"
        "assert error['clairvoyant'] < error['fixed'] and best in error\n"
        # the filter that is fed by hand is the one of the contest
        "from kfenv.agents.contest.rollout import rollout\n"
        "from kfenv.agents.contestants.registry import make_agent\n"
        "again = rollout(make_agent(best).with_values(values[best]), 'kfenv/Filter-v0',\n"
        "                MODEL | WORLD, recording, trace=True)\n"
        "assert np.array_equal(np.abs(again.off[:, 0, 0]), off)",
    ),
    "real_gps_log": (
        f"OBSERVATIONS, NAVIGATION = {str(OBSERVED)!r}, {str(BROADCAST)!r}\n"
        "EPISODES, TRIALS, AGENTS, JERKS, SHARE = 2, 1, (), (1.0, 1e-8), 0.4",
        "assert np.all(np.abs(fix_error[known].mean(axis=0)) < (1.0, 1.0, 2.0))\n"
        "assert rms(errors['nominal']) < rms(errors['single-epoch fix'])\n"
        # the replay with the tuned setting is the tuned agent
        "again = replay(test, tuned['fixed-tuned'].values)\n"
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


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    """One for all, whose imports and compiled code every notebook but the first finds made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IPYTHONDIR", str(tmp_path_factory.mktemp("ipython")))
        manager, client = start_new_kernel(kernel_name="python3")
    client.stop_channels()
    yield manager
    manager.shutdown_kernel(now=True)


@pytest.mark.parametrize("name", [pytest.param(n, marks=NEEDS.get(n, ())) for n in SHORT])
def test_it_runs_and_computes_what_it_says(name, kernel, tmp_path):
    notebook, (parameters, checks) = stored(name), SHORT[name]
    (place,) = [
        i for i, cell in enumerate(notebook.cells) if "parameters" in cell.metadata.get("tags", [])
    ]
    notebook.cells.insert(place + 1, nbformat.v4.new_code_cell(parameters))
    notebook.cells.append(nbformat.v4.new_code_cell(checks))
    notebook.cells.insert(0, nbformat.v4.new_code_cell(f"%reset -f\n%cd -q {tmp_path}"))
    NotebookClient(notebook, timeout=240, km=kernel).execute()
    assert not list(tmp_path.iterdir())
