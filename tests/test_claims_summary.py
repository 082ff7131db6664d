"""The README's table of the papers' claims is what the kept run found."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.reproduction.claims import FAILS, HOLDS, Claim, write_claims
from kfenv.agents.reproduction.summary import (
    BEGIN,
    END,
    KEPT,
    read_claims,
    summary,
    write_summary,
)
from typer.testing import CliRunner

README = Path(__file__).parents[1] / "README.md"
CLAIMS = [
    Claim("C3 (E1)", "UKF | better", "S0, S1 sec. 4", "0.5 m of 53. All: 1/2/3", FAILS, 500, 0),
    Claim("C3 (E2)", "UKF | better", "S0, S1 sec. 4", "9.5 m of 200", HOLDS, 500, 0),
    Claim("E3 rain", "it is survived", "S0 sec. 5.1", "lost: 0", HOLDS, 3, 0),
    Claim("hard: far", "none is lost", "own claim", "lost: 1", FAILS, 200, 0),
]


def kfenv(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_readme_shows_the_kept_run():
    shown = README.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0].strip()
    assert shown == summary(read_claims(KEPT))


def test_a_row_tells_claim_numbers_and_verdict():
    lines = summary(CLAIMS).splitlines()
    assert lines[2:] == [
        "| C3: UKF \\| better (S0, S1 sec. 4) | E1: 0.5 m of 53; E2: 9.5 m of 200 "
        "| E1 does not hold, E2 holds |",
        "| E3 rain: it is survived (S0 sec. 5.1) | E3: lost: 0 | holds |",
        "",
        "Runs: E1 500, E2 500, E3 3 of 40, hard 200; seed 0. "
        "**A short run: more may change verdicts.**",
    ]


def test_a_full_run_is_not_called_short():
    assert summary(CLAIMS[:2]).endswith("\n\nRuns: E1 500, E2 500; seed 0.")


@pytest.mark.parametrize("change", [{"verdict": HOLDS}, {"measured": "0.6 m"}, {"runs": 4}])
def test_a_change_is_seen(change):
    assert summary([replace(CLAIMS[0], **change), *CLAIMS[1:]]) != summary(CLAIMS)


def test_the_command_renews_the_table_and_nothing_else(tmp_path):
    write_claims(CLAIMS, tmp_path)
    assert read_claims(tmp_path / "claims.json") == CLAIMS
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    result = kfenv("claims", tmp_path, "--readme", readme)
    assert result.exit_code == 0 and "E3 rain" in result.output
    expected = f"before\n{BEGIN}\n{summary(CLAIMS)}\n{END}\nafter\n"
    assert readme.read_text() == expected
    write_summary(CLAIMS, readme)
    assert readme.read_text() == expected


@pytest.mark.parametrize("text", ["none", f"{END} {BEGIN}", BEGIN])
def test_a_readme_without_markers_is_left_alone(tmp_path, text):
    write_claims(CLAIMS, tmp_path)
    readme = tmp_path / "README.md"
    readme.write_text(text)
    result = kfenv("claims", tmp_path, "--readme", readme)
    assert result.exit_code == 2 and "claims: begin" in result.output
    assert readme.read_text() == text


def test_what_holds_no_claims_is_refused(tmp_path):
    assert kfenv("claims", tmp_path).exit_code == 2
    for content in ("[", json.dumps([asdict(CLAIMS[0]) | {"more": 1}]), "[1]"):
        (tmp_path / "claims.json").write_text(content)
        result = kfenv("claims", tmp_path)
        assert result.exit_code == 2 and "holds no claims" in result.output
