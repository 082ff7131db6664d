"""Memory that is not given back is seen."""

import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.fuzzing import soak
from typer.testing import CliRunner


def test_growth_is_told_from_warm_up_and_jitter():
    flat = [300, 400, 500, 500, 501, 500, 499, 500, 500, 501, 500, 499, 500, 500, 500]
    assert abs(soak.growth(flat)) < 0.005
    leak = [500 + 2 * i for i in range(20)]
    assert soak.growth(leak) > soak.MOST_GROWTH
    with pytest.raises(ValueError, match="too few to tell"):
        soak.growth(flat[:3])


def test_the_command_fails_where_memory_is_kept(monkeypatch):
    kept = []
    monkeypatch.setattr(soak, "_round", lambda number: None)
    assert CliRunner().invoke(app, ["soak", "--minutes", "0"]).exit_code == 0
    monkeypatch.setattr(soak, "_round", lambda number: kept.append(bytearray(b"x" * 30_000_000)))
    told = CliRunner().invoke(app, ["soak", "--minutes", "0"])
    assert told.exit_code == 1 and "5 rounds" in told.output


def test_a_round_does_all_of_it(monkeypatch):
    monkeypatch.setattr(soak, "STEPS", 2)
    monkeypatch.setattr(soak, "SUB_ENVIRONMENTS", 2)
    soak._round(0)
