"""`kincal reproduce`: what it writes, twice the same; and its statistics beside scipy's on made-up data."""

import csv
import json
import re
from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from kincal.pipeline.commands.app import main
from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.report.paper import AXES, RANGES, TESTING
from kincal.pipeline.reproduce import study as reproduce
from kincal.pipeline.reproduce.claims import claims, pretraining
from kincal.pipeline.reproduce.paired import holm, paired, signed_rank, trend
from kincal.pipeline.reproduce.study import Point, Reproduced, Study, plan, points, tables_points
from kincal.pipeline.reproduce.tables import choices, over_range, ranges
from kincal.pipeline.results import RAW
from kincal.pipeline.run.fingerprint import ROOT
from kincal.urdf.description import load_robot
from kincal.urdf.errors import InputError

PAPER = ROOT.parents[1] / "shared" / "reference" / "xu2024_transfer_calibration.txt"
WRITTEN = {
    *("index.html", "results.parquet", "results.json", "advantage.svg", "pretraining.svg"),
    *(f"figure{k}.svg" for k in (5, 6, 7, 8, 10)),
    *("table1.csv", "table2.csv", "figure10.csv", "ranges.csv", "transfer_claims.csv", "pretraining.csv"),
}
TINY = Study(
    measured=27,
    drawn_from=30,
    sizes=(10, 30),
    hidden=4,
    prior=64,
    other_hidden={3: (10,)},
    priors=(8, 64),
    few_beyond=8,
    few_seeds=1,
)
QUICK = (
    'measure.channels=["orientation"]',
    *("pretrain.iterations=60", "pretrain.continued=5", "transfer.iterations=40"),
    *("siblings.count=4", "siblings.poses=40", "siblings.iterations=20", "siblings.hidden=4"),
    *("correct.own_units=4", "correct.shared_units=4"),
)

# The command


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """The folder in which the command ran with two seeds of a tiny study, into `first`."""
    folder = tmp_path_factory.mktemp("reproduced")
    with pytest.MonkeyPatch.context() as patch:
        assert run_tiny(folder, "first", patch) == 0
    return folder


def run_tiny(folder: Path, output: str, patch: pytest.MonkeyPatch, *more: str) -> int:
    patch.setattr(reproduce, "STUDY", TINY)
    patch.chdir(folder)
    settings = [part for setting in QUICK for part in ("--set", setting)]
    with pytest.raises(SystemExit) as left:
        main(["reproduce", "--seeds", "2", "--on", "1", "--output", output, *more, *settings])
    return int(left.value.code or 0)


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def artifacts(folder: Path) -> dict[str, int]:
    return {str(f): f.stat().st_mtime_ns for f in (folder / ".kincal" / "artifacts").glob("*/*/manifest.json")}


def test_all_is_written_and_a_second_run_runs_nothing(reproduced, monkeypatch, capfd):
    before = artifacts(reproduced)
    assert run_tiny(reproduced, "second", monkeypatch, "--json") == 0
    said = capfd.readouterr()
    lines = [line for line in said.err.splitlines() if line.startswith("ups3_s")]
    assert len(lines) > len(points(replace(TINY, seeds=2)))
    assert all(line.endswith("cached") for line in lines)
    assert artifacts(reproduced) == before
    first = contents(reproduced / "first")
    assert set(first) == WRITTEN
    assert contents(reproduced / "second") == first
    assert json.loads(said.out) == json.loads(first["results.json"])


def test_rows_of_every_job_and_method(reproduced):
    table = pd.read_parquet(reproduced / "first" / "results.parquet")
    assert len(table) == len(points(replace(TINY, seeds=2))) * (1 + len(METHODS))
    assert set(table["method"]) == {RAW, *METHODS}
    known = table[table["method"] != RAW]
    errors = [name for name in table if name.endswith("_deg") and not name.startswith("closed")]
    assert known[errors].notna().all(axis=None)
    closed = table[table["closed_loop_mean_deg"].notna()]  # only the tables' jobs close the loop
    place = closed[["planned_poses", "n", "hidden", "prior_poses"]].drop_duplicates()
    assert place.to_numpy().tolist() == [[27, 27, 4, 64]]


def test_table_2_is_the_comparison(reproduced):
    """Errors pose by pose, which the tables are made of, agree with what `kincal compare` says of the same jobs."""
    table = pd.read_parquet(reproduced / "first" / "results.parquet")
    jobs = table[(table["planned_poses"] == 27) & (table["prior_poses"] == 64)]
    cells = list(csv.DictReader((reproduced / "first" / "table2.csv").read_text().splitlines()))
    assert len(cells) == 2 * (1 + len(METHODS)) * 3
    for cell in cells:
        if cell["method"] == RAW and cell["scored_on"] == "held_out":
            continue  # nobody else says it
        errors = jobs[jobs["method"] == cell["method"]][f"{cell['scored_on']}_{cell['index']}_deg"].astype(float)
        assert float(cell["median_deg"]) == pytest.approx(errors.median(), rel=1e-9)


def test_the_page_stands_alone(reproduced):
    page = (reproduced / "first" / "index.html").read_text()
    assert page.count("<svg") == 7
    outside = re.sub(r"(?s)<svg.*?</svg>", "", page)
    assert not re.search(r"(src|href)=", outside)
    assert str(reproduced) not in page
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))
    used = re.findall(r'(?:url\(#|href="#)([^)"]+)', page)
    assert set(used) <= set(names)


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("--seeds", "0"), "--seeds 0: allowed are 1 to 200"),
        (("--on", "0"), "--on 0: allowed is"),
        (("--set", "plan.poses=20"), "reproduce chooses plan.poses itself"),
        (("--set", "seed=3"), "reproduce chooses seed itself"),
        (("--set", 'measure.channels=["tilt"]'), "orientations of a virtual robot"),
        (("--output", "file"), "--output file: can't be written: "),
    ],
)
def test_what_it_refuses(cli, tmp_path, arguments, said):
    (tmp_path / "file").write_text("")
    answer = cli("reproduce", *arguments)
    assert answer.status == 2
    assert said in answer.err
    assert len(answer.err.splitlines()) == 1


# The jobs


def test_the_study_is_the_papers():
    study = Study()
    found = points(study)
    assert len(found) == len(set(found)) == 210 + 10 + 120 + 5 * 10 + 2 * 2
    assert {p.n for p in found if p.planned == 216 and p.hidden == 16} == set(range(10, 211, 10))
    robot, jobs = plan(study, (), Path("store"))
    assert robot.name == "ups3_s"
    closed = [case.place for case in jobs.points if case.robot.evaluate.closed_loop]
    assert set(closed) == set(tables_points(study))
    assert all(a.seed != b.seed for a, b in pairwise(found))


# The paper


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper's text is not here")
def test_the_papers_numbers_stand_in_its_text():
    text = PAPER.read_text()
    table_1, table_2 = (text[text.index(f"\nTable {k}. Simulated") :][:1500] for k in (1, 2))
    for index, label in (("mean", "Mean"), ("max", "Maximum"), ("sd", "SD")):
        for table, axes in ((table_1, AXES[:3]), (table_2, AXES[3:])):
            printed = next(line for line in table.splitlines() if line.startswith(label)).split("\t")[1:]
            ours = [TESTING[method, axis, index] for method in ("nominal", "network", "transfer") for axis in axes]
            assert [float(cell) for cell in printed] == ours
    prose = text[text.index("- $10 \\leq n < 50$") : text.index("- $50 \\leq n < 180$")]
    assert RANGES[0].mean_deg == {"nominal": 0.203, "transfer": 1.158}
    assert all(f"{value}" in prose for value in RANGES[0].mean_deg.values())


# Statistics, on made-up results


def made_up(errors) -> Reproduced:
    """errors(method, n, seed): mean error [deg] of every job of the study, all else the same."""
    study, rows = replace(Study(), seeds=10, priors=(8, 1331)), []
    for point in points(study):
        for method in METHODS:
            place = {"seed": point.seed, "planned_poses": point.planned, "n": point.n, "hidden": point.hidden}
            value = errors(method, point)
            numbers = {f"{way}_{index}_deg": value for way in ("fresh", "held_out") for index in reproduce._INDICES}
            rows.append(place | {"prior_poses": point.prior, "method": method} | numbers)
    return Reproduced(study, load_robot("ups3_s").description, tuple(rows), ())


def fading(method: str, point: Point) -> float:
    """Transfer gains 30 times at n = 10 and nothing from n = 180, all with noise; hybrid is best, nominal flat."""
    random = np.random.default_rng([METHODS.index(method), point.n, point.seed, point.hidden, point.prior])
    noise = np.exp(0.05 * random.normal())
    size = {"nominal": 0.2, "geometric": 0.01, "network": 60 / point.n**2, "hybrid": 0.0001}.get(method)
    gain = max(1.0, 30 * (1 - (point.n - 10) / 170))
    return noise * (60 / point.n**2 / gain if size is None else size)


@pytest.fixture(scope="module")
def faded() -> Reproduced:
    return made_up(fading)


def test_ranges_and_choices(faded):
    for which, sizes in zip(RANGES, (range(10, 50, 10), range(50, 180, 10), range(180, 211, 10)), strict=True):
        by_seed = [np.mean([fading("network", Point(s, 216, n, 16, 1331)) for n in sizes]) for s in range(10)]
        np.testing.assert_allclose(over_range(faded, which, "fresh")["network"], by_seed, rtol=1e-12)
        row = next(r for r in ranges(faded) if r["range"] == which.label and r["method"] == "network")
        assert row["median_deg"] == pytest.approx(np.median(by_seed))
        assert row["high_deg"] == pytest.approx(np.quantile(by_seed, 0.75))
    made = [c for c in choices(faded) if c.scored_on == "fresh"]
    assert [c.of_two for c in made] == ["transfer", "transfer", "network"]
    assert all((c.best, c.paper) == ("hybrid", which.choice) for c, which in zip(made, RANGES, strict=True))


def test_neither_where_both_are_worse_than_nothing():
    bad = made_up(lambda method, point: fading(method, point) * (100 if method in ("network", "transfer") else 1))
    assert choices(bad)[0].of_two == "neither"


def test_the_one_that_is_better_than_nothing():
    lone = made_up(lambda method, point: fading(method, point) * {"transfer": 100, "network": 0.1}.get(method, 1))
    assert choices(lone)[0].of_two == "network"


def test_claims_of_an_advantage_that_fades(faded):
    first = next(c for c in claims(faded) if c.hidden == 16 and c.scored_on == "fresh")
    assert first.fading is not None
    assert first.many is not None
    assert first.fading.rho < -0.9
    assert "the advantage fades with n" in first.fades
    assert first.sizes[0].compared.ratio == pytest.approx(30, rel=0.1)
    assert first.sizes[0].p_holm == pytest.approx(21 * stats.wilcoxon(np.ones(10) + np.arange(10)).pvalue)
    assert first.many.ratio == pytest.approx(1, abs=0.05)
    assert {c.hidden for c in claims(faded)} == {8, 10, 16}


def test_claims_of_no_difference():
    same = made_up(lambda method, point: 0.1)
    for c in claims(same):
        assert all(s.compared.p == s.p_holm == 1.0 for s in c.sizes)
        assert c.fading is None
        assert "ahead at 0 of" in c.better
        assert "not shown any more" in c.vanishes
    assert {row["over_usual"] for row in pretraining(same)} == {1.0}


def test_paired_is_scipys():
    random = np.random.default_rng(0)
    for n in (5, 10, 30):
        first, second = np.exp(random.normal(size=(2, n)))
        found, logarithm = paired(first, second), np.log(first / second)
        assert found.p == pytest.approx(stats.wilcoxon(logarithm).pvalue)
        assert found.ratio == pytest.approx(np.exp(np.median(logarithm)))
        assert (found.low, found.high) == pytest.approx(tuple(np.exp(np.quantile(logarithm, [0.25, 0.75]))))
        assert found.second_better == np.count_nonzero(first > second)
        assert paired(second, first).p == pytest.approx(found.p)
    assert signed_rank(np.zeros(4)) == 1.0
    assert signed_rank(np.array([0.0, 1, 2, 3])) == signed_rank(np.array([1.0, 2, 3]))


def test_trend_is_scipys():
    random = np.random.default_rng(1)
    n, ratios = np.arange(10, 211, 10), np.exp(random.normal(size=(10, 21)) - 0.05 * np.arange(21))
    found = trend(n, ratios)
    assert found is not None
    whole = stats.spearmanr(n, np.median(np.log(ratios), axis=0))
    own = [stats.spearmanr(n, row).statistic for row in ratios]
    assert (found.rho, found.p) == pytest.approx((whole.statistic, whole.pvalue))
    assert (found.rho_by_seed, found.p_by_seed) == pytest.approx((np.median(own), stats.wilcoxon(own).pvalue))
    assert trend(n[:2], ratios[:, :2]) is None
    assert trend(n, np.ones((10, 21))) is None


def test_the_trend_over_few_sizes_is_exact():
    """Six sizes have 720 orders, of which one falls throughout and one rises; and those that are as far from none."""
    n, ratios = np.arange(6), np.array([np.exp(-np.arange(6.0)), np.exp(-2 * np.arange(6.0))])
    falling = trend(n, ratios)
    assert falling is not None
    assert (falling.rho, falling.p) == pytest.approx((-1, 2 / 720))
    order = [1, 0, 2, 3, 5, 4]
    other = trend(n, ratios[:, order])
    rhos = np.array([stats.spearmanr(n, some).statistic for some in permutations(range(6))])
    assert other is not None
    assert other.p == pytest.approx(np.mean(np.abs(rhos) >= abs(other.rho) - 1e-12))


def test_holm():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.001]) == pytest.approx([0.9, 0.002])


def test_other_channels_are_refused():
    with pytest.raises(InputError, match=r"measure\.channels must hold"):
        plan(Study(), ('measure.channels=["position"]',), Path("store"))
