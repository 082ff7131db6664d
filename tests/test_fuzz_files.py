"""Damaged files give sound numbers or one sentence that names them.

``kfenv fuzz`` tries the same for as long as one likes. Each fault that it found has a test of its
own here.
"""

import json

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.leaderboard import read_results
from kfenv.agents.contest.scores import Scores, read_scores, write_scores
from kfenv.agents.fuzzing import campaign
from kfenv.agents.fuzzing.campaign import TookTooLong, fuzz
from kfenv.agents.fuzzing.readers import READERS, SAMPLES, Files, check_complaint
from kfenv.agents.fuzzing.subject import Wrong, load_case
from kfenv.agents.fuzzing.subjects import GROUPS, make_subjects
from kfenv.agents.reproduction.summary import KEPT, read_claims
from typer.testing import CliRunner

from kfenv.names import excerpt
from kfenv.scenarios.positions import read_positions
from kfenv.scenarios.reports import load_track

CASES = {name: 60 for name in (*READERS, *GROUPS["folders"])}


@pytest.mark.parametrize("name", READERS)
def test_what_is_whole_is_read(name):
    for paths in Files(name)._sets:
        READERS[name].read(*paths)
        if READERS[name].use is not None:
            READERS[name].use(*paths)


@pytest.mark.parametrize("name", CASES)
def test_what_is_damaged_is_read_or_named(name, tmp_path):
    tallies = fuzz(make_subjects((name,)), 0, tmp_path, cases=CASES[name])
    assert tallies[name].findings == {} and tallies[name].cases == CASES[name]


# ----- the campaign itself ----------------------------------------------------------------


class Faulty:
    """Fails in the third case and in the fifth, in other words; the sixth does not end."""

    name = "faulty"

    def draw(self, rng):
        return {"x": rng.random(3), "text": b"\xff\0", "plain": {"a": [1, None]}}

    def attempt(self, case):
        self.count = getattr(self, "count", 0) + 1
        if self.count in (3, 5):
            raise KeyError(f"'{self.count}' of {case['x']}")
        if self.count == 6:
            raise TookTooLong("for ever")
        if self.count == 8:
            raise KeyboardInterrupt
        return 7


def test_findings_are_told_once_and_kept(tmp_path):
    tallies = fuzz([Faulty()], 4, tmp_path, minutes=1.0)
    tally = tallies["faulty"]
    assert (tally.cases, tally.steps) == (7, 28)  # Ctrl-C in the eighth
    assert sorted(often for often, _ in tally.findings.values()) == [1, 2]
    assert len(list(tmp_path.iterdir())) == 2
    for _, path in tally.findings.values():
        name, case = load_case(path)
        assert name == "faulty" and case["text"] == b"\xff\0" and case["plain"] == {"a": [1, None]}
        assert case["x"].shape == (3,)


def test_the_same_seed_draws_the_same_cases(tmp_path):
    [one], [other] = make_subjects(("tracks",)), make_subjects(("tracks",))
    cases = [subject.draw(np.random.default_rng(5)) for subject in (one, other)]
    assert cases[0] == cases[1]


def test_what_does_not_end_is_stopped(monkeypatch):
    class Endless(Faulty):
        def attempt(self, case):
            while True:
                try:
                    sum(range(1000))
                except Exception:
                    continue

    monkeypatch.setattr(campaign, "LONGEST", 0.2)
    _, wrong = campaign.attempt(Endless(), {})
    assert "TookTooLong" in wrong


def test_the_command_finds_replays_and_says_so(monkeypatch, tmp_path):
    run = CliRunner().invoke
    arguments = ["fuzz", "--minutes", "0.02", "--what", "claims", "--output", str(tmp_path)]
    told = run(app, arguments)
    assert told.exit_code == 0 and "claims" in told.output and not list(tmp_path.iterdir())
    monkeypatch.setattr("kfenv.agents.fuzzing.folders.read_claims", lambda path: 1 / 0)
    told = run(app, arguments)
    assert told.exit_code == 1 and "ZeroDivisionError" in told.output
    [path] = tmp_path.iterdir()
    told = run(app, ["fuzz", "--replay", str(path)])
    assert told.exit_code == 1 and "ZeroDivisionError" in told.output
    monkeypatch.undo()
    assert run(app, ["fuzz", "--replay", str(path)]).exit_code == 0
    for wrong in (["--what", "clams"], ["--replay", str(SAMPLES / "tracks" / "flight.csv")],
                  ["--samples", str(tmp_path)]):  # fmt: skip
        assert run(app, ["fuzz", "--minutes", "0.01", *wrong]).exit_code == 2


@pytest.mark.parametrize("said", ["no", "a.csv: " + "x" * 1000, "a.csv: \x1b[2J", "a.csv\n" * 9])
def test_poor_complaints_are_seen(said):
    check_complaint("a.csv: the column is missing; rename it.", ["a.csv"])
    with pytest.raises(Wrong):
        check_complaint(said, ["a.csv"])


# ----- what it found ----------------------------------------------------------------------


def test_what_a_file_holds_is_quoted_in_short_and_in_letters(tmp_path):
    shown = "a\N{REPLACEMENT CHARACTER}[2J" + "b" * 55 + " ..."
    assert excerpt("a\x1b[2J" + "b" * 100) == shown
    path = tmp_path / "flight.csv"
    path.write_text("t\x1b[2J,lat," + "x" * 5000 + "\n")
    with pytest.raises(ValueError, match=r"alt_m|'t'") as caught:
        load_track(path)
    check_complaint(str(caught.value), [path.name])
    path.write_text("t,lat,lon,alt_m\n1,2,3," + "x" * 5000)
    with pytest.raises(ValueError, match="is no number") as caught:
        load_track(path)
    check_complaint(str(caught.value), [path.name])


def test_numbers_that_nothing_measures_are_refused(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("t,lat,lon,alt_m\n1,1e308,2,3\n")
    with pytest.raises(ValueError, match=r"'lat' in line 2 holds .*more than anything measures"):
        load_track(path)


@pytest.mark.parametrize("name", ["truth.csv", "truth.pos"])
@pytest.mark.filterwarnings("error")
def test_positions_that_are_no_numbers_are_named(name, tmp_path):
    path = tmp_path / name
    text = (SAMPLES / "rinex" / name).read_text()
    path.write_text(text.replace("48.0000000000", "inf", 1))
    with pytest.raises(ValueError, match=r"position 1 is no number; leave such rows out"):
        read_positions(path)
    for quality in ("nan", "9e19"):
        path.write_text(text.replace(" 1 9\n", f" {quality} 9\n"))
        assert name.endswith("csv") or not read_positions(path).quality.any()


def test_scores_of_other_kinds_are_damaged(tmp_path):
    columns = np.ones((3, 2))
    sound = Scores(columns[:, 0], columns[:, 0] > 2.0, columns[:, 0], columns, 1.0)
    for name, wrong in (
        ("rmse", columns), ("nis", columns[:2]), ("lost", np.array(["a", "b", "c"])),
        ("rmse", np.ones(3, complex)), ("seconds", columns), ("rmse", np.float64(1.0)),
    ):  # fmt: skip
        write_scores(tmp_path, "fixed", Scores(**(vars(sound) | {name: wrong})), {}, None)
        with pytest.raises(ValueError, match=r"fixed\.npz .*delete it, and --resume"):
            read_scores(tmp_path, "fixed", 3)
    write_scores(tmp_path, "fixed", sound, {}, None)
    assert read_scores(tmp_path, "fixed").seconds == 1.0


@pytest.mark.parametrize("content", [[3], [{"suite": "no"}], [{"suite": {}}], [{"suite": "gnss"}]])
def test_results_of_another_form_are_named(content, tmp_path):
    (tmp_path / "results.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"results\.json is damaged .*give the command"):
        read_results(tmp_path)


@pytest.mark.parametrize(
    "change", [{"seed": None}, {"name": ""}, {"verdict": "maybe"}, {"measured": 3}, {"x": 1}]
)
def test_claims_of_another_form_are_named(change, tmp_path):
    path = tmp_path / "claims.json"
    claims = json.loads(KEPT.read_text())[:2]
    path.write_text(json.dumps(claims))
    assert len(read_claims(path)) == 2
    path.write_text(json.dumps([claims[0] | change]))
    with pytest.raises(ValueError, match=r"claims\.json holds no claims"):
        read_claims(path)
    path.write_bytes(b"\xff")
    with pytest.raises(ValueError, match=r"claims\.json holds no claims"):
        read_claims(path)
