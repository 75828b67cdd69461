"""What the paper says of transfer learning, tested: is it better, does that fade, what does more prior data buy?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.pipeline.report.paper import BP, RANGES, TRANSFER
from kincal.pipeline.reproduce.paired import SIGNIFICANT, Paired, Trend, holm, paired, trend
from kincal.pipeline.reproduce.study import Reproduced, Row
from kincal.pipeline.reproduce.tables import SCORED_ON, column, studied, summed_up, values

_MANY = RANGES[-1].low  # n from which the paper sees no difference
_COLUMNS = (
    *("claim", "hidden", "scored_on", "n", "seeds", "network_median_deg", "transfer_median_deg", "ratio_median"),
    *("ratio_low", "ratio_high", "transfer_better_seeds", "rho", "p", "p_holm"),
)


@dataclass(frozen=True)
class AtSize:
    """Transfer against the BP network at one n."""

    n: int
    network_deg: float  # medians over seeds
    transfer_deg: float
    compared: Paired
    p_holm: float  # for all n of this network size


@dataclass(frozen=True)
class Claims:
    """The paper's claims for networks of one size, scored in one way."""

    hidden: int
    scored_on: str
    sizes: tuple[AtSize, ...]
    fading: Trend | None
    many: Paired | None  # over each seed's mean logarithm where n >= 180

    @property
    def better(self) -> str:
        shown = sum(s.p_holm < SIGNIFICANT and s.compared.ratio > 1 for s in self.sizes)
        worse = [s.n for s in self.sizes if s.p_holm < SIGNIFICANT and s.compared.ratio < 1]
        ahead = sum(s.compared.ratio > 1 for s in self.sizes)
        least = f"shown (p < {SIGNIFICANT:g} after Holm) at {shown}"
        never = f"shown to be worse at n = {', '.join(map(str, worse))}" if worse else "never shown to be worse"
        return f"transfer is ahead at {ahead} of {len(self.sizes)} sizes n, {least}, {never}"

    @property
    def fades(self) -> str:
        if self.fading is None:
            return "too few sizes to say whether its advantage fades"
        rho, p, shown = self.fading.rho_by_seed, self.fading.p_by_seed, self.fading.p_by_seed < SIGNIFICANT
        verdict = f"the advantage {'fades' if rho < 0 else 'grows'} with n" if shown else "no trend with n is shown"
        of_medians = f"{self.fading.rho:+.2f} of the medians, p = {self.fading.p:.2g}"
        return f"{verdict} (Spearman's rho of ratio and n {rho:+.2f} by seed, p = {p:.2g}; {of_medians})"

    @property
    def vanishes(self) -> str:
        if self.many is None:
            return f"no sizes n >= {_MANY}"
        many, verdicts = self.many, {1: "it is still there", 0: "it is not shown any more", -1: "it is a disadvantage"}
        ratio = f"BP over transfer {many.ratio:.2f}, quartiles {many.low:.2f} to {many.high:.2f}, p = {many.p:.2g}"
        return f"where n >= {_MANY} {verdicts[many.says]} ({ratio})"


def claims(results: Reproduced) -> list[Claims]:
    """For each size of network, and for either way of scoring."""
    study = results.study
    hidden = [study.hidden, *(h for h in study.other_hidden if h != study.hidden)]
    return [_claims(results, h, scored_on) for h in sorted(hidden) for scored_on in SCORED_ON]


def _claims(results: Reproduced, hidden: int, scored_on: str) -> Claims:
    network, transfer = (studied(results, hidden, method) for method in (BP, TRANSFER))
    n, name = np.array(list(network)), column(scored_on, "volumetric")
    first, second = (np.array([values(by[k], name) for k in network]).T for by in (network, transfer))  # (seeds, sizes)
    compared = [paired(first[:, k], second[:, k]) for k in range(len(n))]
    adjusted = holm([c.p for c in compared])
    sizes = tuple(
        AtSize(int(n[k]), float(np.median(first[:, k])), float(np.median(second[:, k])), compared[k], adjusted[k])
        for k in range(len(n))
    )
    many = None
    if any(n >= _MANY):
        many = paired(*(np.exp(np.log(e[:, n >= _MANY]).mean(axis=1)) for e in (first, second)))
    return Claims(hidden, scored_on, sizes, trend(n, first / second), many)


def claims_rows(results: list[Claims]) -> list[Row]:
    """One row a network size, n and way of scoring; then those of n >= 180, and of the trend."""
    empty = dict.fromkeys(_COLUMNS)
    rows = []
    for c in results:
        own = empty | {"hidden": c.hidden, "scored_on": c.scored_on}
        for s in c.sizes:
            row = own | {"claim": "transfer better", "n": s.n, "network_median_deg": s.network_deg}
            rows.append(row | {"transfer_median_deg": s.transfer_deg} | _compared(s.compared) | {"p_holm": s.p_holm})
        if c.many is not None:
            rows.append(own | {"claim": f"transfer better where n >= {_MANY}"} | _compared(c.many))
        if c.fading is not None:
            whole, by_seed = (c.fading.rho, c.fading.p), (c.fading.rho_by_seed, c.fading.p_by_seed)
            for claim, (rho, p) in (("trend of medians", whole), ("trend by seed", by_seed)):
                rows.append(own | {"claim": f"advantage against n: {claim}", "rho": rho, "p": p})
    return rows


def _compared(c: Paired) -> dict[str, float]:
    ratios = {"ratio_median": c.ratio, "ratio_low": c.low, "ratio_high": c.high}
    return {"seeds": c.seeds} | ratios | {"transfer_better_seeds": c.second_better, "p": c.p}


def pretraining(results: Reproduced) -> list[Row]:
    """The amount of pre-training data: one row an amount, method and way of scoring; ratios to the paper's amount."""
    study, rows = results.study, []
    for method in (TRANSFER, "transfer_identified"):
        place = {"planned_poses": study.measured, "hidden": study.hidden, "method": method}
        by_place = {(r["prior_poses"], r["seed"]): r for r in results.rows if place.items() <= r.items()}
        for amount in study.priors:
            amount_rows = [row for (prior, _), row in by_place.items() if prior == amount]
            usual = [by_place[study.prior, row["seed"]] for row in amount_rows]
            for scored_on in SCORED_ON:
                name = column(scored_on, "volumetric")
                row = {"prior_poses": amount, "method": method, "scored_on": scored_on, "seeds": len(amount_rows)}
                row |= summed_up(values(amount_rows, name))
                row |= {"max_median_deg": float(np.median(values(amount_rows, column(scored_on, "volumetric", "max"))))}
                over = paired(values(amount_rows, name), values(usual, name))
                row |= {"over_usual": over.ratio, "p": None if amount == study.prior else over.p}
                rows.append(row)
    return rows
