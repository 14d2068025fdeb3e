"""Tolerance, decision and verdict: their levels in every output, what is drawn and run, and the recommended method."""

import re
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from hostile import printed, settings
from samples.small_part import CORNER, GCODE, assignments, small_part

from kr270_milling.base.column import as_dict
from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, compensator, expected_deviations, record_of, robot_passes, simulate
from kr270_milling.cell.models import modal_model_of, path_of
from kr270_milling.cell.plant import perturbed
from kr270_milling.cell.sections import Tolerances
from kr270_milling.decide import compensation
from kr270_milling.decide.check import exchange_share
from kr270_milling.decide.decision import CAUTION, NO, YES, Decision, Limit, limits
from kr270_milling.decide.part.assessment import SURFACE_ERROR, Judgement, gauge_of, judge_part, rigid_part
from kr270_milling.decide.part.assessment import judge as tolerance_judge
from kr270_milling.decide.verdict import (
    HELPS,
    INDIFFERENT,
    NO_METHOD,
    TRACKED,
    UNTRUSTED,
    MethodComparison,
    Verdict,
    alternatives,
    coarser,
    compare_methods,
    errors_as_programmed,
    judge_plants,
    monte_carlo,
    run_sample,
)  # fmt: skip
from kr270_milling.physics.compensation.compensator import Compensator, remaining_error
from kr270_milling.show.report.tables import typeset


def part(**features):
    rows = tuple(SimpleNamespace(name=n, max_wall=w, max_floor=f, max_surface=np.nan) for n, (w, f) in features.items())
    walls, floors = ([getattr(row, key) for row in rows] for key in ("max_wall", "max_floor"))
    whole = SimpleNamespace(max_wall=np.nanmax(walls), max_floor=np.nanmax(floors), max_surface=np.nan)
    return SimpleNamespace(rows=rows, whole=whole)


def test_the_error_that_is_farthest_beyond_its_own_tolerance_decides():
    def judged(rows, **tolerances):
        return judge_part(Tolerances(**tolerances), rows)

    limits = {"tolerance": 50e-6, "floor_tolerance": 10e-6, "features": ("pocket=30",)}
    result = judged(part(slot=(49e-6, 9e-6), pocket=(40e-6, np.nan)), **limits)
    assert not result.passes and result.feature == "pocket" and result.tolerance == pytest.approx(30e-6)
    assert result.words == "largest wall or floor error misses 30 um (40 um at pocket)"
    assert judged(part(slot=(49e-6, 9e-6)), tolerance=50e-6).passes is True
    result = judged(part(slot=(49e-6, 9e-6)))  # no tolerance
    assert result.passes is None and result.wall == 49e-6 and result.error == 49e-6


@pytest.mark.parametrize("text", ["pocket", "=30", "pocket=", "pocket=-1", "pocket=nan"])
def test_a_feature_tolerance_that_cannot_be_meant_is_refused(text):
    with pytest.raises(ConfigError, match="part.features"):
        read_cell(find_file("paper.yaml"), [f'part.features=["{text}"]'])


# --- The three levels, and the method that ``best`` writes ---
MOVING = ("dynamics.reference_inertia=true", "dynamics.damping_ratio=0.04", "dynamics.mass_model=rigid")
UM = 1e-6


def judgement(error: float, tolerance: float) -> Judgement:
    passes = error <= tolerance if tolerance else None
    return Judgement(error, error, passes, error, tolerance, "pocket", SURFACE_ERROR)


def plants(*errors: float, tolerance: float = 100 * UM) -> Verdict:
    rows = UM * np.array(errors)
    return Verdict(HELPS, "", 2 * rows, rows, 1, {}, SURFACE_ERROR, rows / tolerance if tolerance else None)


def decision(error: float = 5 * UM, tolerance: float = 100 * UM, **more) -> Decision:
    return Decision(judgement(120 * UM, tolerance), judgement(error, tolerance), "inverse", **more)


MEETS = "largest wall or floor error meets 100 um on the model (5 um)"


@pytest.mark.parametrize(("result", "level", "sentence"), [
    (decision(verdict=plants(*[50] * 9, 300)), YES, f"{MEETS} and in 9 of 10 simulated robots (90 %, median 50 um)"),
    (decision(verdict=plants(*[50] * 5, *[300] * 5)), CAUTION, f"{MEETS} and in 5 of 10 simulated robots (50 %"),
    (decision(verdict=plants(*[50] * 9, *[118] * 19), limits=(Limit("base", 0.4, "load tests"),)), NO,
     f"{MEETS} and in 9 of 28 simulated robots (32 %, median 118 um); measure: base, load tests: from 9 to about 28"),
    (decision(verdict=plants(*[50] * 8, np.nan, np.nan)), CAUTION, f"{MEETS} and in 8 of 10"),  # two plants failed
    (decision(130 * UM, verdict=plants(*[50] * 10)), NO, "misses 100 um on the model (130 um at pocket)"),
    (decision(stops=("axis 5 leaves its range", "another"), verdict=plants(*[50] * 10)), NO,
     "the path must not be run: axis 5 leaves its range, and 1 more"),
    (decision(), CAUTION, "no verdict of simulated robots"),
    (decision(tolerance=0.0, verdict=plants(50, 60, tolerance=0.0)), CAUTION,
     "is 5 um on the model, median 55 um in 2 simulated robots; no tolerance is given: set part.tolerance_um"),
])  # fmt: skip
def test_stop_model_and_nine_of_ten_plants_decide_and_the_sentence_has_the_reason(result, level, sentence):
    assert (result.level, result.exit_code) == (level, level == NO) and sentence in result.sentence
    assert result.may_be_run == ("must not be run" not in sentence)


def test_the_only_unknown_has_the_whole_band_and_a_measurement_of_it_brings_every_robot_within(tmp_path):
    """Two unknowns, of which one changes nothing here: a delay of motors that follow no correction."""
    part = small_part(tmp_path, GCODE, *MOVING)
    numbers = {k: 0.0 for k, v in vars(part.uncertainty).items() if isinstance(v, float) and k != "reference_inertia"}
    known = part.uncertainty.replace(servo_frequency=np.array([]), end_share=np.array([]), **numbers)
    soft = part.replace(uncertainty=known.replace(base_compliance=0.08e-6, servo_delay=4e-3))
    first, second = limits(soft, path_of(soft).target, 2)
    assert (first.name, second.name) == ("base", "servo lag") and first.share == pytest.approx(1.0, abs=1e-12)
    assert first.within(np.array([0.9, 1.5, 3.0])) == 3 and second.within(np.array([0.9, 1.5, 3.0])) == 1
    assert limits(part.replace(uncertainty=known), path_of(part).target, 2) == ()
    target = path_of(part).target
    bent = target.with_position(target.position + np.outer(1e-4 * (np.arange(len(target)) % 2), [0.0, 1.0, 0.0]))
    identified = known.replace(base_compliance=0.08e-6, servo_frequency=np.array([18.0, 18.0]))
    shares = {row.name: row.share for row in limits(part.replace(uncertainty=identified), bent, 2)}
    assert shares["servo lag"] == pytest.approx(0.0, abs=1e-9)  # every robot has the same lag


def test_six_robots_know_the_shares_of_many_within_a_fifth(tmp_path):
    part = small_part(tmp_path, CORNER, *MOVING, "cutting.detail=engagement")
    few, many = ({row.name: row.share for row in limits(part, path_of(part).target, n)} for n in (6, 24))
    largest = [name for name, share in many.items() if share > 0.1]
    assert len(largest) > 1
    assert [few[name] for name in largest] == pytest.approx([many[name] for name in largest], rel=0.2)


def test_a_method_is_recommended_only_where_methods_were_compared():
    assert decision(verdict=plants(50)).recommended_method is None
    assert decision().method_text == "method: inverse, as set"
    compared = decision(comparison=MethodComparison("inverse", "inverse, because", {}))
    assert compared.recommended_method == "inverse" and compared.method_text == "recommended method: inverse, because"


def run(directory, capsys, *words: str):
    """Run ``compensate`` once: its exit code, what it prints for a reader, its JSON, its programs and their headers."""
    sets = settings(*assignments(directory, CORNER, *MOVING, "cutting.detail=engagement"))
    code, text, result, _ = printed(capsys, "compensate", "paper.yaml", "--out", str(directory / "out"), *sets, *words)
    programs = list((directory / "out").rglob("*.src"))
    headers = [" ".join(re.findall(r"^; (.*)$", path.read_text(), re.MULTILINE)) for path in programs]
    return code, text, result, programs, headers


def test_a_refused_path_gets_no_program_or_a_marked_one(tmp_path, capsys):
    words = ["--verdict", "0", "--method", "linear", "--set", "limits.spindle_torque_n_m=0.001"]
    _, _, _, programs, _ = run(tmp_path, capsys, *words)
    assert not programs
    code, _, result, programs, headers = run(tmp_path, capsys, *words, "--force")
    assert (code, result["decision"], result["may_be_run"]) == (1, "no", False)
    assert programs and all(path.name.startswith("NOT_RELEASED") for path in programs)
    stop = next(f for f in result["check"]["findings"] if f["severity"] == "stop")
    assert all("decision no: see MANIFEST.txt" in header for header in headers)
    manifest = (tmp_path / "out" / "MANIFEST.txt").read_text()
    assert stop["sentence"] in manifest and "decision: no: the path must not be run" in manifest


@pytest.mark.parametrize(("tolerance", "level", "method", "robots"), [
    ("600", YES, "best", "4"), ("0.2", NO, "inverse", "0"),
])  # fmt: skip
def test_decision_and_chatter_are_the_same_in_every_output_of_a_run(
    tmp_path, capsys, few_robots, tolerance, level, method, robots
):
    words = ["--method", method, "--verdict", robots, "--force", "--set", f"part.tolerance_um={tolerance}"]
    code, text, result, programs, headers = run(tmp_path, capsys, *words)
    assert code == (level == NO) and result["decision"] == level and result["may_be_run"] is True
    line, chatter = f"decision: {level}: {result['sentence']}", result["check"]["stability"]["text"]
    assert chatter.startswith("stability: arm: stable") and text.splitlines()[0] == line
    manifest = (tmp_path / "out" / "MANIFEST.txt").read_text()
    assert line in manifest.splitlines() and chatter in manifest and chatter in text
    report = (tmp_path / "out" / "report.html").read_text()
    assert f'<span class="label">decision</span><strong>{level}</strong>' in report
    assert result["sentence"].replace(" um", " µm") in report and typeset(chatter.removeprefix("stability: ")) in report
    written = result["method"]
    if method == "best":  # the method that is recommended is the one that is written
        assert written == result["recommended_method"] == "robust"
        assert f"recommended method: {written}, because" in text
        assert set(result["verdict"]["methods_um"]) == {NO_METHOD, written}  # the verdict runs no other method
        assert result["verdict"]["quantity"] == SURFACE_ERROR
    assert "exchange: largest correction of a predicted pose is" in text
    assert len(headers) == 2 and all(f"decision {level}: see MANIFEST.txt" in header for header in headers)
    assert any(f"method {written}" in header for header in headers)
    for path in programs:
        assert path.name.startswith("NOT_RELEASED") == (level == NO) and f"krl_spline_{written}_" in path.parent.name


def test_best_writes_the_path_as_programmed_where_no_method_helps(tmp_path, monkeypatch):
    cell = small_part(tmp_path, GCODE, "compensation.method=best")
    monkeypatch.setattr(compensation, "compare_methods", lambda *_: MethodComparison(NO_METHOD, "none, because", {}))
    done = compensation.compensate(cell)
    assert done.revised.name == "none" and done.revised.reference is done.original.reference
    assert done.decision.method == done.decision.recommended_method == "none"


def test_best_takes_learned_only_with_a_tracker(tmp_path, few_robots):
    cell = small_part(tmp_path, CORNER, *MOVING, "compensation.method=best", "cutting.detail=engagement")
    original = simulate(cell)
    result = compare_methods(cell, original)
    assert set(result.deviations) == {"none", "spline", "inverse", "robust"}
    assert result.deviations[result.best] == min(result.deviations.values())
    tracked = cell.replace(compensation=cell.compensation.replace(tracker=True))
    assert compare_methods(tracked, original).best == "learned"
    for one, method in ((cell, "inverse"), (tracked, "learned")):  # a node that runs compares nothing
        assert Compensator(one.compensation, path_of(one).target).method == method


def test_an_exchange_that_is_too_coarse_is_a_stop(tmp_path):
    cell = small_part(tmp_path, GCODE)
    ran = simulate(cell)
    share, _, findings = exchange_share(path_of(cell), ran, cell.tolerances)
    feed_per_tooth = path_of(cell).feed_rate / (cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth)
    assert share == pytest.approx(ran.result.correction.max() / feed_per_tooth) and not findings
    strict = cell.replace(exchange=cell.exchange.replace(stop_correction=0.5 * share))
    done = compensation.compensate(strict, "linear")
    assert done.decision.level == NO and "largest correction of a predicted pose" in done.decision.sentence


# --- The verdict ---
SHORT = ("path.length_mm=16", "stock.grid_step_um=40", "stock.max_mm=[16,12,0]")
#: eq. (1) of the paper, a perfect robot on a rigid base, a sharp and rigid tool
AS_PRINTED = {
    "reference_inertia": 0.0, "repeatability": 0.0, "backlash": 0.0, "tool_wear": 0.0, "base_compliance": 0.0,
    "tool_stick_out": 0.0, "servo_frequency": np.zeros(0), "servo_delay": 0.0, "joining": 0.0,
    "end_share": np.zeros(0),
}  # fmt: skip
CERTAIN = {
    **AS_PRINTED, "joint_compliance": 0.0, "force_coefficient": 0.0, "damping_ratio": 0.0, "frequency": 0.0,
    "placement": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def cell():
    return read_cell(find_file("paper.yaml"), SHORT)


@pytest.fixture(scope="module")
def pair(cell):
    original = simulate(cell)
    return original, compensated(cell, original, "spline")


def draw(cell, count: int, seed: int = 0) -> list:
    rng = np.random.default_rng(seed)
    return [perturbed(cell, rng) for _ in range(count)]


#: of a part with six compliances and six coefficients, the last two axial, each with a separate spread
SPREADS = [0.01, 0.02, 0.04, 0.08, 0.16, 0.32]
SIX = "cutting.linear_edge.axial_edge_n_per_mm=-3", f"uncertainty.joint_compliances={SPREADS}"
#: a tool and a base that are not rigid; deviation of their compliances
SOFT, OTHERS = ("tool.stiffness_n_per_um=4", "arm.base_compliance_urad_per_n_m=[0.1,0.0,0.2]"), [0.2, 0.2, 0.2]


def known(cell) -> np.ndarray:
    """Return the numbers of a cell that scatter: of the arm, of the force law, damping ratio, base and tool."""
    law = cell.cutting.active
    names = ("tangential_cutting", "axial_cutting", "axial_edge") if cell.cutting.law == "linear_edge" else (
        "stiffness", "radial_ratio")  # fmt: skip
    soft = *cell.arm.base_compliance[[0, 2]], cell.tool.lateral_compliance
    return np.array([*cell.arm.joint_compliance, *(getattr(law, n) for n in names), cell.dynamics.damping_ratio, *soft])


@pytest.mark.parametrize(("file", "settings", "spreads"), [
    ("paper.yaml", ("uncertainty.joint_compliance=0.3", "uncertainty.force_coefficient=0.1"), [*[0.3] * 6, 0.1, 0.1]),
    ("test_piece.yaml", (*SIX, "uncertainty.force_coefficients=[0.05,0.1,0.1,0.1]"), [*SPREADS, 0.05, 0.3, 0.3]),
    ("test_piece.yaml", (*SIX, "uncertainty.force_coefficients=[0.05,0.1,0.1,0.1,0.2,0.4]"),
     [*SPREADS, 0.05, 0.2, 0.4]),
])  # fmt: skip
def test_what_a_cell_knows_scatters_about_its_value_each_number_by_its_own_deviation(file, settings, spreads):
    """Log-normal of relative deviation v: ln has the deviation sqrt(ln(1 + v^2)). Four standard deviations of n."""
    words = *settings, *SOFT, "uncertainty.damping_ratio=0.25", "uncertainty.tool_wear=0.0"
    cell, n = read_cell(find_file(file), words), 400
    logarithms = np.log([known(plant) for plant in draw(cell, n)] / known(cell))
    expected = np.sqrt(np.log1p(np.square([*spreads, 0.25, *OTHERS])))
    assert logarithms.std(0) == pytest.approx(expected, rel=4 / np.sqrt(2 * n))
    assert np.all(np.abs(logarithms.mean(0)) < 4 / np.sqrt(n) * expected)
    assert np.abs(np.corrcoef(logarithms.T) - np.eye(len(expected))).max() < 4 / np.sqrt(n)


def test_what_a_cell_does_not_know_is_drawn_evenly_from_none_to_the_stated_limit(cell):
    """The limit of the tool: a carbide bar of 0.8 x 20 mm, 80 mm long: L^3 / (3 E I)."""
    exact = cell.replace(uncertainty=cell.uncertainty.replace(force_coefficient=0.0))
    limit, law = cell.uncertainty, cell.cutting.active
    imperfect = ("pose_noise", "repeatability", "joining")
    longest = 0.08**3 / (3 * 600e9 * np.pi * 0.016**4 / 64)
    assert limit.base_compliance == pytest.approx(0.08e-6) and limit.tool_wear == pytest.approx(0.3)
    plants = draw(exact, 400)
    rows = [
        [
            *p.arm.base_compliance[:2] / limit.base_compliance,
            p.tool.lateral_compliance / longest,
            (p.cutting.active.per_depth(1e-4)[0] / law.per_depth(1e-4)[0] - 1.0) / limit.tool_wear,
            p.cutting.end_share,
            *p.imperfections.backlash / p.arm.backlash / limit.backlash,
            *(getattr(p.imperfections, name) / getattr(limit, name) for name in imperfect),
        ]
        for p in plants
    ]
    assert np.min(rows) >= 0.0 and np.max(rows) <= 1.0 + 1e-9
    assert np.mean(rows, axis=0) == pytest.approx(0.5, abs=4 / np.sqrt(12 * 400))
    assert not any(p.arm.base_compliance[2] for p in plants)  # as joint 1 turns the arm
    assert len({p.imperfections.seed for p in plants}) == 400


def test_frequencies_and_the_place_of_the_part_scatter_and_a_stated_share_moves_with_its_motors(cell):
    uncertainty = {**CERTAIN, "frequency": 0.1, "reference_inertia": 0.5, "placement": 1e-4}
    plants = draw(cell.replace(uncertainty=cell.uncertainty.replace(**uncertainty)), 400)
    factors = np.array([modal_model_of(p).frequency[0] for p in plants[:60]]) / modal_model_of(cell).frequency[0]
    assert np.log(factors).std() == pytest.approx(0.1, rel=0.4) and np.median(factors) == pytest.approx(1.0, abs=0.04)
    share = np.mean([p.dynamics.reference_inertia for p in plants])
    assert share == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(400))
    low, high = (np.array([getattr(p.stock, end) - getattr(cell.stock, end) for p in plants]) for end in ("min", "max"))
    assert low.std(axis=0) == pytest.approx(1e-4, rel=0.15) and np.abs(low).max() < 3.001e-4
    np.testing.assert_allclose(high, low, atol=1e-12)


def test_a_certain_plant_is_the_model_and_gives_its_scores(cell, pair):
    (plant,) = draw(cell.replace(uncertainty=cell.uncertainty.replace(**CERTAIN)), 1)
    rows = run_sample(plant, path_of(cell).target, [ran.reference for ran in pair], gauge_of(cell))
    assert rows[:, 0] == pytest.approx([ran.scores.max_deviation for ran in pair], rel=1e-9)
    assert np.isnan(rows[:, 1]).all()


def test_the_paper_is_helped_and_its_bands_enclose_the_model(cell, pair):
    original, revised = pair
    cell = cell.replace(uncertainty=cell.uncertainty.replace(**AS_PRINTED))
    verdict = monte_carlo(cell, revised.reference, 12)
    low, middle, high = verdict.band("original")
    assert verdict.word == HELPS and low < original.scores.max_deviation < high and low < middle < high
    assert np.all(verdict.compensated < 0.7 * verdict.original)  # each one, though forces that differ by 30 % overlap
    assert as_dict(verdict)["original_um"] == pytest.approx([1e6 * v for v in (low, middle, high)])


def test_a_seed_gives_the_same_verdict_on_any_number_of_cores_and_another_one_other_samples(cell, pair, monkeypatch):
    verdicts = []
    for cores, seed in (({0}, 1), ({0, 1, 2}, 1), ({0}, 2)):
        monkeypatch.setattr("os.sched_getaffinity", lambda _, cores=cores: cores)
        verdicts.append(monte_carlo(cell, pair[1].reference, 5, seed))
    first, again, other = verdicts
    assert np.array_equal(first.original, again.original) and np.array_equal(first.compensated, again.compensated)
    assert not np.any(first.original == other.original)


def test_a_correction_of_the_wrong_sign_and_plants_that_fail_cannot_be_trusted(cell, pair):
    target, revised = path_of(cell).target, pair[1].reference
    wrong = target.with_position(2 * target.position - revised.position)
    assert monte_carlo(cell, wrong, 6, 1).word == UNTRUSTED
    astray = target.with_position(target.position + np.outer(np.linspace(0, 0.02, len(target)), [0, 1, 0]))
    verdict = monte_carlo(cell, astray, 3, 1)
    assert verdict.word == UNTRUSTED and as_dict(verdict)["failed"] == 3 and "fail" in verdict.reason
    assert np.isnan(verdict.band("compensated")).all()


def test_every_robot_of_a_verdict_counts_once_in_its_progress(cell, pair):
    seen: list[tuple[int, int]] = []
    monte_carlo(cell, pair[1].reference, 3, progress=lambda *done: seen.append(done))
    assert seen == [(1, 3), (2, 3), (3, 3)]
    with pytest.raises(ParameterError, match="samples"):
        monte_carlo(cell, pair[1].reference, 0, 1)


def test_the_plants_of_a_tool_path_are_measured_by_the_walls_and_floors_of_their_parts(tmp_path):
    """A plant that is the model leaves its largest wall or floor error and its share of the tolerance."""
    cell = small_part(tmp_path, GCODE, "part.wall_tolerance_um=30", "part.floor_tolerance_um=10")
    ran = simulate(cell)
    judged, gauge, target = tolerance_judge(cell, ran), gauge_of(cell), path_of(cell).target
    (row,) = run_sample(cell, target, [target], gauge)
    assert row == pytest.approx([judged.error, judged.error / judged.tolerance], rel=1e-9)
    assert row[0] != pytest.approx(ran.scores.max_deviation, rel=0.01)  # another quantity
    moved = cell.stock.replace(min=cell.stock.min + 33e-6, max=cell.stock.max + 33e-6)
    there = run_sample(cell.replace(stock=moved), target, [target], gauge)
    assert there[0, 0] == pytest.approx(row[0], rel=0.1)  # 33 um of 0.5 mm depth are 7 % of the force


def test_robots_that_began_beside_other_work_give_the_verdict_that_all_give_in_turn(tmp_path, monkeypatch):
    """Also where the part of the rigid arm is that of the full exchange, and two of three robots wait for a thread."""
    monkeypatch.setattr("kr270_milling.cell.plant.MANY", 100)
    monkeypatch.setattr("kr270_milling.cell.jobs.FEW_PERIODS", 100)
    cell = small_part(tmp_path, GCODE, "cutting.detail=engagement", "part.wall_tolerance_um=30")
    target = path_of(cell).target
    moved = target.with_position(target.position + [0.0, 10 * UM, 0.0])
    plain = monte_carlo(cell, moved, 3, 1)
    with ThreadPoolExecutor(1) as pool:
        started = errors_as_programmed(cell, 3, 1, pool.submit(rigid_part, cell), pool)
        started[2][0].result()
        verdict = monte_carlo(cell, moved, 3, 1, started=started)
    assert started[0].exchange is not cell.exchange
    np.testing.assert_allclose(verdict.original, plain.original, atol=0.1 * UM)
    np.testing.assert_allclose(verdict.compensated, plain.compensated, atol=0.1 * UM)
    with ThreadPoolExecutor(1) as pool:  # without the exchange of a long program all bits are the same
        monkeypatch.undo()
        started = errors_as_programmed(cell, 3, 1, pool.submit(rigid_part, cell), pool)
        again, plain = monte_carlo(cell, moved, 3, 1, started=started), monte_carlo(cell, moved, 3, 1)
    assert np.array_equal(again.original, plain.original) and np.array_equal(again.compensated, plain.compensated)


def test_a_quick_pass_has_a_grid_of_five_nodes_a_tooth_and_keeps_the_deviation(tmp_path):
    cell = small_part(tmp_path, "G21 S8000 M3\nG0 X-14 Y0 Z-0.5\nG1 X20 F4000\nM30\n")
    nodes = 125e-6 * 10e-3 * np.radians(1.0) / coarser(cell).stock.grid_step ** 2  # f R dphi / ds^2
    assert nodes == pytest.approx(5.0)
    short = cell.replace(exchange=cell.exchange.replace(period=0.25e-3))  # 12 micro-steps of 1 deg
    assert coarser(short).exchange.period == pytest.approx(0.5e-3)
    assert coarser(short).exchange.micro_step == pytest.approx(np.radians(4.0))
    fine = short.replace(stock=cell.stock.replace(grid_step=10 * UM))
    assert coarser(fine).stock.grid_step == pytest.approx(50 * UM)
    rows = [
        run_sample(c, path_of(cell).target, [path_of(cell).target], gauge_of(c))[0, 0] for c in (fine, coarser(fine))
    ]
    assert rows[1] == pytest.approx(rows[0], rel=0.03)


def test_quick_passes_of_a_long_program_have_fewer_exchanges(tmp_path):
    for feed, period in ((6.0, 4e-3), (4.0, 6e-3)):  # [mm/min]: 34 mm in 340 s and in 510 s
        program = f"G21 S8000 M3\nG0 X-14 Y0 Z-0.5\nG1 X20 F{feed}\nM30\n"
        quick = coarser(small_part(tmp_path, program, "cutting.detail=engagement"))
        assert quick.exchange.period == coarser(quick).exchange.period == pytest.approx(period, rel=0.02)


def test_robots_of_a_tool_in_a_holder_share_the_times_of_the_program(tmp_path):
    program = "G21 S8000 M3\nG0 X-14 Y0 Z-0.5\nG1 X20 F4000\nM30\n"
    cell = small_part(tmp_path, program, "tool.holder_mm=[20,0,20,40]", "tool.stick_out_mm=60")
    robots = [perturbed(cell, np.random.default_rng(seed)) for seed in (1, 2)]
    assert robots[0].tool.lateral_compliance != robots[1].tool.lateral_compliance > 0.0
    assert all(path_of(robot).target is path_of(cell).target for robot in robots)


def test_a_verdict_states_how_far_quick_passes_are_from_full_ones_and_runs_full_ones_where_that_is_much(
    tmp_path, monkeypatch
):
    cell = small_part(tmp_path, GCODE, "part.tolerance_um=100", "exchange.period_ms=0.25")
    target = path_of(cell).target
    verdict = monte_carlo(cell, target, 4, 1)
    quick = verdict.compensated
    monkeypatch.setattr("kr270_milling.decide.verdict.NEAR", 1e-9)
    careful = monte_carlo(cell, target, 4, 1)
    full = careful.compensated
    assert careful.shortcut is None and "quick" not in careful.text
    assert verdict.shortcut == pytest.approx(np.abs(quick - full)[:2].max()) and verdict.shortcut > 0.0
    assert f"within {1e6 * verdict.shortcut:.2g} um of full ones" in verdict.text
    for level in (0.5, 0.95):
        assert np.quantile(quick, level) == pytest.approx(np.quantile(full, level), rel=0.05)
    assert np.sum(quick <= 500e-6) == pytest.approx(np.sum(full <= 500e-6), abs=1)


def test_the_method_whose_95_percent_are_least_and_that_harms_no_plant_is_recommended():
    before = np.full(20, 80 * UM)
    often = np.where(np.arange(20) < 17, 1 * UM, 200 * UM)  # the best one mostly, and worse than none in 3 of 20
    methods = {"spline": often, "mirror": np.full(20, 20 * UM), "inverse": np.full(20, 9 * UM)}
    verdict = Verdict(HELPS, "", before, before, 1, methods)
    assert verdict.recommended == "inverse"
    first = np.append(methods["inverse"][:8], np.full(12, 79 * UM))  # on the robots that run all methods it is best
    later = {"inverse": first, "mirror": np.full(8, 20 * UM)}
    assert Verdict(HELPS, "", before, before, 1, later).recommended == "inverse"
    harmful = later | {"inverse": np.where(np.arange(20) < 15, 9 * UM, 200 * UM)}  # a risk to robots behind the first 8
    assert Verdict(HELPS, "", before, before, 1, harmful).recommended == "mirror"
    assert Verdict(HELPS, "", before, before, 1, {"spline": often}).recommended == "none"
    assert Verdict(HELPS, "", before, before, 1, {"linear": np.full(20, 79 * UM)}).recommended == "none"


def test_with_the_inertia_of_the_arm_the_verdict_recommends_the_lifted_model(cell, few_robots):
    """At the damping of measured robots the paper's methods excite the arm; "inverse" knows of it."""
    perfect = cell.uncertainty.replace(repeatability=0.0, backlash=0.0, frequency=0.03)
    dynamics = cell.dynamics.replace(damping_ratio=0.04, reference_inertia=True)
    moving = cell.replace(dynamics=dynamics, uncertainty=perfect)
    original = simulate(moving)
    spline = compensated(moving, original, "spline")
    others = alternatives(moving, original, "spline")
    assert set(others) == {"inverse", "robust"}
    verdict = monte_carlo(moving, spline.reference, 2, method="spline", others=others)
    assert as_dict(verdict)["recommended_method"] == verdict.recommended in others
    assert np.quantile(verdict.methods[TRACKED], 0.95) < np.quantile(verdict.methods["inverse"], 0.95)


def test_robust_plans_with_the_mean_force_and_for_twice_the_robots_where_the_program_is_short(tmp_path, few_robots):
    """The sweep of the teeth exchanges every 0.25 ms, the mean force every 4 ms."""
    cell = small_part(tmp_path, GCODE, "cutting.detail=teeth")
    target = path_of(cell).target
    passes = robot_passes(cell, target, target)
    assert len(passes) == 1 + 2 * 4
    assert np.diff(passes[0][1].time_ns[:2])[0] == pytest.approx(4e6, rel=0.02)


def test_the_linear_model_ranks_the_methods_of_a_tool_path_as_passes_do(tmp_path, few_robots):
    part = small_part(tmp_path, GCODE, *MOVING, "cutting.detail=engagement")
    target, original = path_of(part).target, simulate(part)
    made = {m: compensator(part, target, m).revise(record_of(part, original)) for m in ("linear", "mirror", "inverse")}
    references = [target, *made.values()]
    expected = np.array(expected_deviations(part, references))
    passes = [remaining_error(target, record_of(part, simulate(part, reference))) for reference in references]
    assert expected[:3] == pytest.approx(passes[:3], rel=0.15) and max(expected[3], passes[3]) < 0.05 * passes[0]
    assert set(alternatives(part, original, "learned")) < {"inverse", "robust"}


def samples(*shares: float, before: float = 50 * UM) -> tuple[np.ndarray, np.ndarray]:
    return np.full(len(shares), before), before * np.array(shares)


@pytest.mark.parametrize(("pair", "word"), [
    (samples(*[0.1] * 40), HELPS),
    (samples(*[0.1] * 39, 3.0), HELPS),  # one of forty
    (samples(*[0.1] * 36, *[1.2] * 4), HELPS),  # P(4 of 40) = 0.14 where 5 % become worse
    (samples(*[0.1] * 35, *[1.2] * 5), UNTRUSTED),  # P(5 of 40) = 0.05
    (samples(*[0.1] * 11, 1.2), HELPS),  # one of twelve
    (samples(*[0.95] * 20, *[1.05] * 20), INDIFFERENT),
    (samples(*[0.92] * 36, *[0.5] * 4), INDIFFERENT),
    (samples(*[0.1] * 40, before=9 * UM), INDIFFERENT),
    (samples(*[3.0] * 40, before=9 * UM), UNTRUSTED),  # it would come to matter
    (samples(*[0.1] * 35, *[np.nan] * 5), UNTRUSTED),
    (samples(*[0.1] * 39, np.nan), HELPS),
    ((np.array([np.nan]), np.array([np.nan])), UNTRUSTED),
])  # fmt: skip
def test_the_rule(pair, word):
    word_of_rule, reason = judge_plants(*pair, 10 * UM)
    assert word_of_rule == word and reason
