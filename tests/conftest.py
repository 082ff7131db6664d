"""Before the workers start, the environments' kernels are compiled: once each, two at a time.

``pytest tests/test_golden.py --renew-golden`` writes the committed runs anew.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest
from matplotlib.figure import Figure

import kfenv


def pytest_addoption(parser):
    parser.addoption("--renew-golden", action="store_true", help="write tests/golden anew")


def pytest_configure(config):
    whole_suite = config.args == config.getini("testpaths")
    if whole_suite and config.getoption("numprocesses", None):
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            list(pool.map(compile_kernels, reversed(kfenv.ENVIRONMENTS)))


def compile_kernels(env_id: str) -> None:
    """Step once alone and in a vector; the improvement reward runs whole recordings as well."""
    import gymnasium

    one = gymnasium.make(env_id, reward="improvement", observation="full")
    few = gymnasium.make_vec(env_id, num_envs=2, vectorization_mode="vector_entry_point")
    for env in (one, few):
        env.reset(seed=0)
        env.step(env.action_space.sample() * 0.0)


@pytest.fixture(autouse=True, scope="session")
def coarse_figures():
    """Without a layout, in few pixels: a good one takes half a second, and nobody looks."""
    draw = Figure.savefig

    def savefig(figure, *arguments, **keywords):
        figure.set_layout_engine("none")
        draw(figure, *arguments, **keywords | {"dpi": 30})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", savefig)
        yield


LONG = ("test_notebooks.py", "test_tuned_filter.py", "test_determinism.py", "test_reproduction.py")


def pytest_collection_modifyitems(items):
    """The longest files first, so that no worker is left alone with one at the end."""
    items.sort(key=lambda item: item.path.name not in LONG)
