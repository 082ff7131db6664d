"""`import kfenv` loads Gymnasium and next to nothing else, which keeps it quick."""

import subprocess
import sys

HEAVY = (
    "numba", "torch", "stable_baselines3", "matplotlib", "rich", "typer", "scipy", "pymap3d",
    "cma", "kfenv.agents", "kfenv.envs", "kfenv.filters", "kfenv.scenarios",
)  # fmt: skip


def loaded(statement: str) -> list[str]:
    code = f"import sys\n{statement}\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, timeout=100, capture_output=True, text=True
    )
    return eval(done.stdout)


def test_the_package_is_light():
    assert loaded("import kfenv") == []


def test_an_environment_needs_no_learning_library_and_no_command_line():
    statement = "import gymnasium, kfenv\ngymnasium.make(kfenv.ENVIRONMENTS[0])"
    unwanted = {"torch", "stable_baselines3", "matplotlib", "rich", "typer", "cma", "kfenv.agents"}
    assert unwanted.isdisjoint(loaded(statement))
    assert "numba" in loaded(statement)  # or this test could not fail
