"""Rounding in E1 and E2: every design in single and double precision (SPEC 2.3; C1, C2, C9).

The papers ask what square roots and the Joseph form buy. In double precision their cases are
too easy to tell; in single precision, and from a vague prior, they are not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from kfenv.filters.designs import DESIGNS, FilterDesign
from kfenv.scenarios.radar.validation import RadarValidation

from . import figures, precision_figures
from .claims import Claim, digits, judge
from .comparisons import MATTERS, ROUNDING
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study
from .operations import table_3
from .precision_tally import Tally, distance, on_track, table, tally, write_tables

DTYPES = SINGLE, DOUBLE = "float32", "float64"
EXACT = ("classical", "unsymmetrised", "joseph-omega", "joseph-exact")  # P - K Pzz K^T in algebra
STUDIED: dict[str, FilterDesign] = {name: d for name, d in DESIGNS.items() if name != "lkf"} | {
    "ukf-classical, kappa -6": replace(DESIGNS["ukf-classical"], kappa=-6.0),
    "srukf-classical, kappa -6": replace(
        DESIGNS["srukf-classical"], kappa=-6.0, centre="downdated"
    ),
    "ukf-classical, alpha 1e-3": replace(DESIGNS["ukf-classical"], alpha=1e-3, beta=2.0),
    "srukf-classical, alpha 1e-3": replace(
        DESIGNS["srukf-classical"], alpha=1e-3, beta=2.0, centre="downdated"
    ),
}
KEYS = [(name, dtype) for name in STUDIED for dtype in (DOUBLE, SINGLE)]  # of all tables
CASES = {
    "E1": (RadarValidation(rate=10.0), None),
    "E2": (RadarValidation(rate=2.0), None),
    "E2, prior 100 km": (RadarValidation(rate=2.0), (1e5, 1e3, 1e2)),
}
# One estimator of each transform in four arithmetics.
NEITHER = ("ekf-classical", "ukf-classical", "ckf-classical")
ROOT = ("srekf-classical", "srukf-classical", "srckf-classical")
JOSEPH = ("ekf-joseph", "ukf-joseph-exact", "ckf-joseph-exact")
BOTH = ("srekf-joseph", "srukf-joseph-exact", "srckf-joseph-exact")
LABELS = {NEITHER: "neither", ROOT: "square root", JOSEPH: "Joseph", BOTH: "both"}
FACTORISED = ("ekf-ud", "srekf-carlson")
NEGATIVE = ("srukf-classical, kappa -6", "srukf-classical, alpha 1e-3", "ukf-classical, kappa -6",
            "ukf-classical, alpha 1e-3")  # fmt: skip
CONDITIONED = (
    "ekf-unsymmetrised", "ekf-classical", "ukf-classical", "ukf-joseph-exact", "srekf-carlson",
    "srukf-classical", "srukf-joseph-exact",
)  # fmt: skip

Tallies = dict[tuple[str, str], Tally]


class Case(NamedTuple):
    """A study with its outcomes by design and precision."""

    study: Study
    outcomes: dict[tuple[str, str], Outcome]


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """Figures, a table of every design in both precisions, and what that says of the papers."""
    cases = {name: _run(laboratory, name) for name in CASES}
    tables = {name: _tallies(case) for name, case in cases.items()}
    _draw(laboratory, cases, tables)
    return [
        *_as_printed(tables),
        *_what_is_bought(tables),
        _never_fails(tables),
        _factorised(tables),
        _statistical(cases, tables),
        _downdated(tables),
        *table_3(),
    ]


def _run(laboratory: Laboratory, name: str) -> Case:
    scenario, prior = CASES[name]
    methods = [Method(f"{label} {dtype}", STUDIED[label], dtype=dtype) for label, dtype in KEYS]
    study, outcomes = laboratory.study(name, scenario, methods, initial_deviation=prior)
    pairs = {(label, dtype): outcomes[f"{label} {dtype}"] for label, dtype in KEYS}
    return Case(study, pairs)


def _tallies(case: Case) -> Tallies:
    return {
        (label, dtype): tally(
            case.study, case.outcomes[label, dtype], case.outcomes[_reference(label), DOUBLE]
        )
        for label, dtype in KEYS
    }


def _reference(label: str) -> str:
    """The name of the same estimator in the arithmetic that is trusted most."""
    design = STUDIED[label]
    if design.transform == "extended":
        return "srekf-joseph"
    if design.kappa < 0.0 or design.alpha != 1.0:
        wanted = replace(design, form="covariance", update="classical", centre="stacked")
    else:
        update = "joseph-exact" if design.update in EXACT else design.update
        wanted = replace(design, form="square-root", update=update)
    return next(name for name, studied in STUDIED.items() if studied == wanted)


def _draw(laboratory: Laboratory, cases: dict[str, Case], tables: dict[str, Tallies]) -> None:
    names = tuple(STUDIED)
    told = [n for n in names if any(t[n, d].lost for t in tables.values() for d in DTYPES)]
    kept = {
        name: (case.study.time, {key: on_track(o) for key, o in case.outcomes.items()})
        for name, case in cases.items()
    }
    laboratory.save(precision_figures.survival(told or names, DTYPES, kept), "survival")
    distances = {name: [t[n, SINGLE].rounding for n in names] for name, t in tables.items()}
    laboratory.save(precision_figures.rounding(names, distances), "rounding")
    for name, case in cases.items():
        outcomes = {label: case.outcomes[label, SINGLE] for label in CONDITIONED}
        drawn = figures.condition(case.study.time, outcomes)
        laboratory.save(drawn, f"condition {name}".replace(",", "").replace(" ", "_"))
        runs = case.study.runs
        laboratory.progress.console.print(table(f"{name}, {runs} runs", tables[name]))
    write_tables(tables, laboratory.folder / "designs.md")


def _as_printed(tables: dict[str, Tallies]) -> list[Claim]:
    """When P - K Pzz K^T as printed comes apart."""
    claims = []
    for name in ("E1", "E2"):
        single, double = (tables[name]["ekf-unsymmetrised", d] for d in (SINGLE, DOUBLE))
        cured = tables[name]["ekf-classical", SINGLE].broken == 0
        sigma = max(tables[name][f"{f}-unsymmetrised", SINGLE].broken for f in ("ukf", "ckf"))
        claims.append(
            Claim(
                f"C1 in {name}, float32 (precision)",
                "the classical EKF's covariance loses its conditioning",
                "S0, S1 Fig. 6",
                f"κ(P) > 1e6 in {single.broken} of {single.runs} runs, median "
                f"{single.broken_at:.0f} s, and {single.lost} lost, where float64 has "
                f"{double.broken}, median {double.broken_at:.0f} s, and {double.lost}; "
                f"symmetrised, in float32, {tables[name]['ekf-classical', SINGLE].broken}; "
                f"of the UKF and CKF as printed at most {sigma}",
                judge(single.broken > 0, reason_holds=not cured),
            )
        )
    return claims


def _what_is_bought(tables: dict[str, Tallies]) -> list[Claim]:
    """What a square root, the Joseph form, and both together buy in single precision."""
    return [
        claim
        for case, tallies in tables.items()
        for claim in (
            _bought(tallies, case, "a square root makes the classical filter robust", ROOT),
            _bought(tallies, case, "the Joseph form makes the filter robust", JOSEPH),
            _bought(tallies, case, "Joseph in square roots is more robust than either", BOTH),
        )
    ]


def _bought(tallies: Tallies, case: str, statement: str, group: tuple[str, ...]) -> Claim:
    """Whether fewer filters are spoilt by rounding than in the plainer arithmetics."""
    groups = (NEITHER, ROOT, JOSEPH, BOTH) if group == BOTH else (NEITHER, group)
    spoilt = {g: sum(_spoilt(tallies, label) for label in g) for g in groups}
    moved = {g: "/".join(_moved(tallies[label, SINGLE]) for label in g) for g in groups}
    told = "; ".join(f"{LABELS[g]} {spoilt[g]} ({moved[g]})" for g in groups)
    return Claim(
        f"{LABELS[group]} in {case}, float32 (precision)",
        statement,
        "S0, S1, their theme",
        f"of EKF, UKF and CKF spoilt by rounding, in brackets how far it moves each: {told}. "
        f"Spoilt is what loses more tracks than in float64 or is moved by over {MATTERS:.0%} of "
        "its RMSE",
        judge(spoilt[group] < min(spoilt[g] for g in groups[:-1])),
    )


def _spoilt(tallies: Tallies, label: str) -> bool:
    found, reference = tallies[label, SINGLE], tallies[_reference(label), DOUBLE]
    return found.lost > reference.lost or not found.rounding <= MATTERS * reference.rmse


def _moved(found: Tally) -> str:
    """How far rounding moves a filter, m, or how many tracks it is lost with."""
    return f"{found.lost} lost" if found.lost else f"{digits(found.rounding)} m"


def _never_fails(tables: dict[str, Tallies]) -> Claim:
    told, failed = [], 0
    for case, tallies in tables.items():
        lost = {
            label: tallies[label, SINGLE].lost
            for label in ("srukf-joseph", "srukf-joseph-prior", "srukf-joseph-exact")
        }
        failed += lost["srukf-joseph"]
        told.append(f"{case}: " + ", ".join(f"{label} {count}" for label, count in lost.items()))
    return Claim(
        "C9 in float32 (precision)",
        "SRUKF-Joseph never fails",
        "S0, S1 conclusions",
        f"runs lost in float32: {'; '.join(told)}",
        judge(failed == 0),
    )


def _factorised(tables: dict[str, Tallies]) -> Claim:
    """Bierman's and Carlson's updates against the Joseph form."""
    told, best = [], True
    for case, tallies in tables.items():
        rows = {label: tallies[label, SINGLE] for label in (*FACTORISED, "ekf-joseph")}
        told.append(
            f"{case}: "
            + ", ".join(f"{label} {t.rounding:.1e} m, {t.lost} lost" for label, t in rows.items())
        )
        best &= all(t.lost <= rows["ekf-joseph"].lost for t in rows.values())
    return Claim(
        "Table 3, robustness (precision)",
        "factorised updates are as robust as Joseph's, at a lower cost",
        "S0 Table 3",
        f"EKF in float32, distance from float64 and tracks lost: {'; '.join(told)}",
        judge(best),
    )


def _statistical(cases: dict[str, Case], tables: dict[str, Tallies]) -> Claim:
    """The Joseph form with the H of eq 16, with and without what that H leaves out."""
    told, apart = [], []
    for name, (study, outcomes) in cases.items():
        exact = outcomes["ukf-joseph-exact", DOUBLE]
        moved = {
            label: distance(study, outcomes[label, DOUBLE], exact)
            for label in ("ukf-joseph-statistical", "ukf-joseph-omega")
        }
        rmse = {label: tables[name][label, DOUBLE].rmse for label in moved}
        apart.append(moved["ukf-joseph-statistical"])
        told.append(
            f"{name}: with R {moved['ukf-joseph-statistical']:.2g} m from P - K Pzz Kᵀ "
            f"(RMSE {rmse['ukf-joseph-statistical']:.4g} m), with R + Ω "
            f"{moved['ukf-joseph-omega']:.0e} m (RMSE {rmse['ukf-joseph-omega']:.4g} m)"
        )
    return Claim(
        "F9 (precision)",
        "the Joseph form with H = (P⁻¹Pxz)ᵀ is the classical form",
        "S0 eq 15, 16, 18",
        f"UKF in float64: {'; '.join(told)}",
        judge(max(apart) < ROUNDING),
    )


def _downdated(tables: dict[str, Tallies]) -> Claim:
    """Negative central weights, which the printed cholupdate turns into downdates."""
    told, failed = [], 0
    for case, tallies in tables.items():
        rows = {key: t for key, t in tallies.items() if key[0] in NEGATIVE}
        failed += sum(t.rootless for (name, _), t in rows.items() if name.startswith("sr"))
        ended = [f"{' '.join(key)} {t.rootless}" for key, t in rows.items() if t.rootless]
        moved = [f"{name} {_moved(rows[name, SINGLE])}" for name in NEGATIVE]
        told.append(f"{case}: {', '.join(ended) or 'none'} (float32: {', '.join(moved)})")
    return Claim(
        "F6 (precision)",
        "square-root filters need no downdate that could fail",
        "S0 eq 22, 26",
        f"runs that ended for want of a root where w0 < 0: {'; '.join(told)}",
        judge(failed == 0),
    )
