"""The results of suites as a page of tables, generated and never typed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..files import blamed_on, read_json, written_whole
from . import formatting
from .suites import FLIGHT, IN_DISTRIBUTION, find_suite

Results = list[dict[str, Any]]

REMEDY = "give the command of the suite again, with --resume"


def read_results(folder: Path) -> Results:
    """What `kfenv suite` wrote into a folder.

    Raises:
        ValueError: if it wrote nothing there, or another version's episodes were met.
    """
    path = folder / "results.json"
    results = read_json(path, list, REMEDY) if path.exists() else []
    with blamed_on(path, REMEDY):
        if not results or "suite" not in results[0]:
            name = None
        else:
            name, *told = (results[0][key] for key in ("suite", "version", "recordings"))
    if name is None:
        raise ValueError(f"The folder {folder} holds no results of `kfenv suite`.")
    with blamed_on(path, REMEDY):
        suite = find_suite(name)
    if told != [suite.version, suite.recordings]:
        raise ValueError(
            f"The results in {folder} are not of version {suite.version} of {name}, whose "
            f"recordings have the hash {suite.recordings}: run the suite anew."
        )
    return results


def write_sections(page: Path, folders: Sequence[Path]) -> None:
    """Put the section of each folder's suite into a page, in place of the former one or at its end.

    The rest of the page is left alone; a page that is not there is begun.
    """
    text = page.read_text() if page.exists() else "# Leaderboard\n"
    for folder in folders:
        results = read_results(folder)
        text = _placed(text, results[0]["suite"], section(results, folder, page))
    with written_whole(page) as file:
        file.write(text.encode())


def _placed(text: str, name: str, content: str) -> str:
    begin, end = f"<!-- {name}: generated -->\n", f"<!-- end of {name} -->\n"
    if begin not in text:
        return f"{text.rstrip()}\n\n{begin}{content}{end}"
    before, _, rest = text.partition(begin)
    return before + begin + content + rest[rest.index(end) :]


def section(results: Results, folder: Path, page: Path) -> str:
    """The Markdown of one suite: what it is, both tables, the commands that repeat it.

    Raises:
        ValueError: if the folder's results are damaged.
    """
    with blamed_on(folder / "results.json", REMEDY):
        return _section(results, folder, page)


def _section(results: Results, folder: Path, page: Path) -> str:
    tested = ranked(results)
    return "\n".join([
        f"## {results[0]['suite']}, version {results[0]['version']}", "",
        _about(tested[0]), "",
        *_main_table(tested), "",
        "Geometric means in every case, m, and in brackets the tracks lost, %:", "",
        *_case_table(results, tested), "",
        *_commands(results, tested, folder, page), "",
    ])  # fmt: skip


def ranked(results: Results) -> Results:
    """Those in distribution, the least median first."""
    tested = [result for result in results if result["case"] == IN_DISTRIBUTION]
    return sorted(tested, key=lambda result: result["rmse_median"])


def _about(first: dict[str, Any]) -> str:
    suite, machine = find_suite(first["suite"]), first["machine"]
    keywords = ", ".join(f"`{key}={value!r}`" for key, value in suite.kwargs.items())
    shortened = (
        f" **Shortened to at most {first['episodes_at_most']} episodes a case: a first look.**"
        if first["episodes_at_most"] is not None
        else ""
    )
    return (
        f"`{suite.env_id}` with {keywords}: position RMSE on {first['episodes']} unseen episodes, "
        f"recordings `{first['recordings']}`. Tuned on {suite.tuning_episodes} others with "
        f"{suite.tuning_trials} settings a parameter. {machine['processor']}, {machine['system']}, "
        f"Python {machine['python']}, NumPy {machine['numpy']}.{shortened}"
    )


def _main_table(tested: Results) -> list[str]:
    against = tested[0].get("against")
    compared = "below `fixed`, %" if against is None else f"over `{against}`, %"
    head = ["agent", "median, m", "geo. mean", "p95", "lost, %", "ANEES",
            f"NIS {'/'.join(list(tested[0]['nis'])[1:])}", compared, "cost"]  # fmt: skip
    rows = [
        [
            f"`{result['agent']}`",
            _median(result),
            *(formatting.short(result[key]) for key in ("rmse_geometric_mean", "rmse_p95")),
            f"{100.0 * result['track_loss']:.1f}",
            formatting.consistency(result["anees"]),
            formatting.nis(result["nis"]),
            formatting.improvement(result) if against is None else formatting.ratio(result),
            formatting.cost(result["cost"]),
        ]
        for result in tested
    ]
    return _table(head, rows)


def _median(result: dict[str, Any]) -> str:
    keys = ("rmse_median", "rmse_median_ci_low", "rmse_median_ci_high")
    return formatting.with_interval([result[key] for key in keys], formatting.short)


def _case_table(results: Results, tested: Results) -> list[str]:
    cases = {result["case"]: result["what"] for result in results}
    found = {(result["case"], result["agent"]): result for result in results}
    rows = [
        [f"`{own['agent']}`", *(_error(found.get((case, own["agent"]))) for case in cases)]
        for own in tested
    ]
    return _table(["agent", *(f"{case}: {what}" for case, what in cases.items())], rows)


def _error(result: dict[str, Any] | None) -> str:
    if result is None:
        return "-"
    lost = f" ({100.0 * result['track_loss']:.1f})" if result["track_loss"] > 0.0 else ""
    return formatting.short(result["rmse_geometric_mean"]) + lost


def _commands(results: Results, tested: Results, folder: Path, page: Path) -> list[str]:
    given = sorted(result["given_as"] for result in tested)
    first = tested[0]
    options = [f"--agent {name}" for name in given]
    options += [f"--against {first['against']}"] if "against" in first else []
    options += ["--tracks FOLDER"] if any(r["what"] == FLIGHT for r in results) else []
    options += [f"--episodes {n}" for n in [first["episodes_at_most"]] if n is not None]
    lines, line = [], f"kfenv suite {first['suite']} --output {folder}"
    for option in options:
        if len(line) + len(option) > 90:
            lines, line = [*lines, f"{line} \\"], "   "
        line += f" {option}"
    return ["```", *lines, line, f"kfenv leaderboard {folder} --page {page}", "```"]


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    rule = ["---", *("--:" for _ in head[1:])]
    return [f"| {' | '.join(row)} |" for row in (head, rule, *rows)]
