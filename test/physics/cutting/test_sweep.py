"""The sweep: cutter, stock, polygons, vector instructions, a brute-force oracle on small grids, and the workpiece."""

import resource
import sys

import numpy as np
import pytest
from budget import budget
from hypothesis import example, given, settings
from hypothesis import strategies as st
from llvmlite import binding, ir
from numba import njit
from samples.cuttings import PAPER_LAW

from kr270_milling.base.errors import ConfigError, MillingError, ParameterError
from kr270_milling.base.record import build
from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, Stock, Tool, lanes
from kr270_milling.physics.cutting.fill import clear_quad
from kr270_milling.physics.cutting.grid import TILE
from kr270_milling.physics.cutting.lanes import LANES, NODE, build_lanes, lower_lanes, lower_one_by_one
from kr270_milling.physics.cutting.state import make_params, make_state

PAPER = {"diameter_mm": 20.0, "teeth": 4, "spindle_speed_rpm": 8000.0}
STOCK = Stock(min=np.zeros(3), max=np.array([10e-3, 5e-3, 2e-3]))
BOX = {"min_mm": [0.0, -12.0, -10.0], "max_mm": [100.0, 12.0, 0.0]}


def test_teeth_stand_at_their_pitch_clockwise_at_cos_phi_minus_sin_phi_and_a_micro_step_divides_a_revolution():
    tool = build(Tool, PAPER)
    assert tool.angles == pytest.approx(np.radians([0, 90, 180, 270]))
    assert tool.radii == pytest.approx(np.full(4, 10e-3)) and tool.spindle_speed == pytest.approx(837.758, abs=1e-3)
    uneven = build(Tool, {**PAPER, "teeth": 3, "pitch_deg": [100.0, 110.0, 150.0], "start_angle_deg": 10.0})
    assert uneven.angles == pytest.approx(np.radians([10, 110, 220]))
    for rotation, sense in (("clockwise", -1), ("counterclockwise", 1)):
        params = make_params(build(Tool, {**PAPER, "rotation": rotation}), PAPER_LAW, STOCK, np.radians(1.0))
        assert params.directions[0, 30] == pytest.approx([np.cos(np.pi / 6), sense * 0.5])
        assert params.directions[1, 0] == pytest.approx([0.0, sense], abs=0)
        assert np.array_equal(params.directions[:, 0], params.directions[:, -1])
    assert make_params(tool, PAPER_LAW, STOCK, np.radians(0.75)).steps == 480
    for degrees in (0.0, -1.0, 0.7, 16.0, float("nan")):
        with pytest.raises(ParameterError, match="micro_step"):
            make_params(build(Tool, PAPER), PAPER_LAW, STOCK, np.radians(degrees))


@pytest.mark.parametrize(("kind", "change"), [
    *((Tool, {"pitch_deg": pitch}) for pitch in ([90.0] * 3, [90.0, 90.0, 90.0, 91.0], [90.0, 90.0, 180.0, 0.0])),
    (Tool, {"runout_um": [1.0]}), (Tool, {"diameter_mm": 1.0, "runout_um": [0.0, 0.0, 0.0, -600.0]}),
    (Tool, {"stick_out_mm": 40.0, "holder_mm": [25.0, 30.0, 40.0, 100.0]}),  # a gap of 30 mm below the holder
    *((Tool, {key: 1e-99}) for key in ("diameter_mm", "shank_diameter_mm", "flute_section", "stiffness_n_per_um")),
    *((Stock, {"max_mm": high}) for high in ([100.0, -12.0, 0.0], [100.0, 12.0, -10.0])),
])  # fmt: skip
def test_impossible_cutters_and_stocks_are_refused(kind, change):
    with pytest.raises(ConfigError):
        build(kind, {**{Tool: PAPER, Stock: BOX}[kind], **change})


# --- The innermost step of the sweep ---
def lowered(lower, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pool and log after 16 nodes from number 5 were lowered to level 300; the log from number 2 on."""
    pool = np.random.default_rng(count).integers(0, 600, 40).astype(np.uint16)
    log = np.zeros(40, np.uint16)
    lower(pool, np.uint64(5), log, np.uint64(2), np.uint16(count), np.uint16(300))
    return pool, log


@njit
def by_vectors(pool, start, log, place, count, level):
    lower_lanes(pool, start, log, place, count, level)


def test_plain_loop_and_vector_instructions_lower_the_same_nodes_and_without_instructions_the_loop_is_taken():
    for count in (0, 1, 7, LANES):
        expected, _ = lowered(lambda *_: None, count)
        before = expected[5 : 5 + count].copy()
        expected[5 : 5 + count] = np.maximum(before, 300)
        for lower in (lower_one_by_one, by_vectors):
            pool, log = lowered(lower, count)
            assert np.array_equal(pool, expected) and np.array_equal(log[2 : 2 + count], before)

    def build(builder, *values):  # as before 0.44
        builder.load(values[0], no_such_argument=NODE)

    assert lanes.lowering(build) is lower_one_by_one
    assert lanes.lowering(build_lanes) is not lower_one_by_one


def test_the_instructions_are_valid_with_opaque_pointers(monkeypatch):
    """As in an llvmlite without typed pointers: every pointer type of the module is ``ptr``."""
    monkeypatch.setattr(ir.Type, "as_pointer", lambda self, addrspace=0: ir.PointerType())
    pointer, wide = ir.PointerType(), ir.IntType(64)
    module = ir.Module()
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [pointer, wide, pointer, wide, NODE, NODE]), "lower")
    builder = ir.IRBuilder(function.append_basic_block())
    build_lanes(builder, *function.args)
    builder.ret_void()
    assert "i16*" not in str(module)
    binding.parse_assembly(str(module)).verify()


# --- Clearing of polygons, against a point-in-polygon test by crossing numbers ---
SIZE = 30
SHEET = Stock(min=np.zeros(3), max=np.array([3e-3, 3e-3, 1e-3]), grid_step=1e-4)
corner = st.floats(-10.0, 40.0)


def inside(xs, ys):
    """Even number of sides to the right of a node: outside. And the distance of the node to the nearest side."""
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    odd, near = np.zeros((SIZE, SIZE), bool), np.full((SIZE, SIZE), np.inf)
    for a, b, c, d in zip(xs, ys, np.roll(xs, -1), np.roll(ys, -1), strict=True):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            odd ^= ((b > y) != (d > y)) & (x < a + (y - b) / (d - b) * (c - a))
            at = np.clip(np.nan_to_num(((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2)), 0, 1)
        near = np.minimum(near, np.hypot(x - a - at * (c - a), y - b - at * (d - b)))
    return odd, near


@settings(max_examples=budget(200), deadline=None)
@example((0.0, 0.0, 0.0, 2.2e-309), (0.0, 0.0, 0.0, 1.0))
@given(st.tuples(*[corner] * 4), st.tuples(*[corner] * 4))
def test_a_quadrilateral_is_cleared_inside_and_nowhere_else(xs, ys):
    tool = Tool(diameter=1e-3, teeth=1, spindle_speed=1.0)
    state = make_state(make_params(tool, PAPER_LAW, SHEET, np.radians(10.0)), SHEET, 4096)
    clear_quad(state, xs, ys, SIZE, SIZE, 7)
    cleared = state.pool[: 256 * SIZE].reshape(SIZE, 256)[:, :SIZE] == 7
    odd, near = inside(xs, ys)
    assert np.array_equal(cleared[near > 1e-6], odd[near > 1e-6])


# --- The compiled sweep against a brute-force oracle on small grids, and what a sweep must conserve ---
STEP = 1e-4  # [m] grid step of the small grids here
NODES = 40


def small_cut(radius=12.0, teeth=4, degrees=10.0, shift=0, **kwargs):
    """A square of NODES nodes a side with its corner at 0; ``shift`` more nodes to the left and below."""
    tool = Tool(diameter=2 * radius * STEP, teeth=teeth, spindle_speed=100.0, **kwargs)
    low = np.array([-shift * STEP, -shift * STEP, -1e-3])
    stock = Stock(min=low, max=np.array([NODES * STEP, NODES * STEP, 0.0]), grid_step=STEP, floor_tolerance=0.0)
    return Cut(tool, PAPER_LAW, stock, np.radians(degrees))


def levels(cut):
    x, y, z = cut.heights([0.0, 0.0], [NODES * STEP, NODES * STEP])
    assert z.shape == (NODES, NODES)
    return np.rint(-z / cut.stock.level_step).astype(int)


def below(centre):
    """The nodes of a small cut below a cutter of 9 nodes radius."""
    middle = (np.arange(NODES) + 0.5) * STEP
    return np.hypot(middle[:, None] - centre[0], middle[None, :] - centre[1]) < 8.99 * STEP


class Oracle:
    """Every node against every tooth line: when does the line pass over it, and how far out on the line?

    ``must``, ``may``: the levels that a correct sweep reaches at least and at most; they differ within ``margin``
    nodes of the borders only: a line must have gone from beyond the margin on one side to beyond it on the other.
    """

    def __init__(self, cut, margin=0.08):
        self.cut, self.margin = cut, margin
        self.must, self.may = np.zeros((2, NODES, NODES), np.int64)
        teeth = cut.tool.teeth
        self.side = np.zeros((teeth, NODES, NODES), np.int64)  # of the node when it was last clear of the line
        self.level = np.zeros((teeth, NODES, NODES), np.int64)  # then
        self.within = np.zeros((teeth, NODES, NODES), np.bool_)  # was it inside the tooth's length since?
        self.near = np.zeros((teeth, NODES, NODES), np.bool_)  # was it anywhere near that since?

    def sweep(self, start, end, first, n):
        samples = 9 + int(8 * np.hypot(*(end - start)[:2]) / STEP / n)
        for k in range(n):
            parts = (k + np.linspace(0.0, 1.0, samples)) / n
            level = int(round((-(start[2] + (k + 0.5) / n * (end[2] - start[2]))) / self.cut.stock.level_step))
            centres = start[:2] + parts[:, None] * (end - start)[:2]
            turns = (first + parts * n) * self.cut.params.micro_step
            for i, radius in enumerate(self.cut.tool.radii):
                state = self.must, self.may, self.side[i], self.level[i], self.within[i], self.near[i]
                angles = self.cut.tool.angles[i] + turns
                lines = np.stack([np.cos(angles), self.cut.tool.sense * np.sin(angles)], 1)
                pass_over(centres / STEP, lines, radius / STEP, self.margin, level, *state)


@njit
def pass_over(centres, lines, radius, margin, level, must, may, side, last, within, near):
    """Move one tooth through some positions (k, 2) and directions (k, 2); lengths in nodes."""
    for k in range(len(centres)):
        for row in range(NODES):
            for column in range(NODES):
                at = row, column
                x, y = row + 0.5 - centres[k, 0], column + 0.5 - centres[k, 1]
                along, beside = x * lines[k, 0] + y * lines[k, 1], x * lines[k, 1] - y * lines[k, 0]
                inside = margin < along < radius - margin
                outside = along < -margin or along > radius + margin
                clear, now = abs(beside) > margin, 1 if beside > 0 else -1
                crossed = clear and now == -side[at]
                if crossed and inside and within[at]:
                    must[at] = max(must[at], min(last[at], level))
                if (crossed and (not outside or near[at])) or not (outside or clear):
                    may[at] = max(may[at], level, last[at] if crossed else 0)
                within[at] = inside and (clear or within[at])
                near[at] = not outside or (not clear and near[at])
                last[at] = level if clear else min(last[at], level)
                if clear:
                    side[at] = now


@st.composite
def passes(draw):
    """A cutter, and legs (end, micro-steps) of its way: slow ones, fast ones and jumps, at two depths."""
    teeth = draw(st.integers(1, 5))
    spread = draw(st.lists(st.floats(0.6, 1.4), min_size=teeth, max_size=teeth))
    tool = dict(
        teeth=teeth,
        radius=draw(st.floats(6.0, 14.0)),
        degrees=draw(st.sampled_from([15.0, 10.0, 6.0])),
        rotation=draw(st.sampled_from(["clockwise", "counterclockwise"])),
        start_angle=draw(st.floats(0.0, 3.0)),
        pitch=np.array(spread) / sum(spread) * 2 * np.pi,
        runout=STEP * np.array(draw(st.lists(st.floats(-0.7, 0.7), min_size=teeth, max_size=teeth))),
    )
    seed, count = draw(st.integers(0, 2**32 - 1)), draw(st.integers(1, 6))
    rng = np.random.default_rng(seed)
    here = np.array([*(STEP * rng.uniform(-5, NODES + 5, 2)), -4e-4])
    legs = [here]
    for _ in range(count):
        n = int(rng.integers(1, 40))
        speed = STEP * 10 ** rng.uniform(-2.5, 0.5)  # [m] a micro-step
        turn = rng.uniform(0, 2 * np.pi)
        z = -rng.choice([4e-4, 7e-4]) if rng.random() < 0.4 else here[2]
        here = np.array([here[0] + n * speed * np.cos(turn), here[1] + n * speed * np.sin(turn), z])
        legs.append((here, n))
    return tool, legs


#: a node beside the axis: from the centre it turns by half a turn, away from the teeth, while whole sectors are swept
BESIDE_THE_AXIS = (
    dict(radius=10.0, teeth=5, degrees=6.0, pitch=np.radians([90.0, 67.5, 67.5, 67.5, 67.5])),
    [np.array([1.138e-3, 1.824e-3, -4e-4]), (np.array([1.259e-3, 1.782e-3, -4e-4]), 30)],
)


@settings(max_examples=budget(60), deadline=None)
@example(BESIDE_THE_AXIS)
@given(passes())
def test_every_node_has_the_level_that_brute_force_gives_it(case):
    tool, (here, *legs) = case
    cut = small_cut(**tool)
    oracle, first = Oracle(cut), 0
    for end, n in legs:
        cut.sweep(here, end, first, n)
        oracle.sweep(here, end, first, n)
        here, first = end, first + n
        # one level of slack: the oracle rounds the level at mid-step by itself
        assert np.all(levels(cut) >= oracle.must - 1), "a node that a tooth passed over is left standing"
        assert np.all(levels(cut) <= oracle.may + 1), "a node that no tooth reached is gone"


def test_each_node_counts_once_whatever_teeth_touch_it_and_a_second_level_removes_the_volume_between():
    cut = small_cut(radius=9.0)
    ends = STEP * np.array([[-12.0, 20.0], [10.0, 18.0], [30.0, 25.0], [20.0, 5.0]])
    for k, (a, b) in enumerate(zip(ends, ends[1:], strict=False)):
        cut.sweep([*a, -5e-4], [*b, -5e-4], 2000 * k, 2000)
    assert cut.removed_area == pytest.approx(np.count_nonzero(levels(cut)) * STEP**2, rel=1e-12)
    assert cut.removed_volume == pytest.approx(cut.removed_area * 5e-4, rel=1e-12)
    twice = small_cut(radius=9.0)
    for k, z in enumerate((-2e-4, -5e-4)):
        twice.sweep([2e-3, 2e-3, z], [2.4e-3, 2e-3, z], 1000 * k, 1000)
    nodes = np.count_nonzero(levels(twice))
    assert twice.removed_volume == pytest.approx(nodes * STEP**2 * 5e-4, rel=1e-4)
    assert twice.removed_area == pytest.approx(nodes * STEP**2, rel=1e-12)  # not again when it is cut deeper


def test_a_plunge_lowers_the_whole_footprint_and_the_floor_is_within_its_tolerance_of_the_tool():
    cut = small_cut(radius=9.0, degrees=5.0)
    here = np.array([2.013e-3, 2.007e-3, 0.0])
    cut.sweep(here, here + [0.0, 0.0, -3e-4], 0, 720)
    cut.sweep(here + [0.0, 0.0, -3e-4], here + [0.0, 0.0, -3e-4], 720, 72)
    floor = levels(cut)[below(here)] * cut.stock.level_step
    assert floor == pytest.approx(3e-4, abs=cut.stock.level_step)
    tool = Tool(diameter=18 * STEP, teeth=2, spindle_speed=100.0)
    stock = Stock(min=np.array([0, 0, -1e-3]), max=np.array([4e-3, 4e-3, 0]), grid_step=STEP, floor_tolerance=5e-6)
    cut = Cut(tool, PAPER_LAW, stock, np.radians(5.0))
    here = np.array([2e-3, 2e-3, -1e-4])
    cut.sweep(here, here, 0, 200)
    cut.sweep(here, here - [0, 0, 3e-5], 200, 2000)
    deepest = -cut.heights()[2].min()
    floor = -cut.heights([1.7e-3, 1.7e-3], [2.3e-3, 2.3e-3])[2]
    assert np.all(floor >= deepest - 6e-6)
    assert np.all(floor > 1.2e-4)


def test_result_depends_neither_on_where_tile_borders_fall_nor_on_the_number_of_calls():
    # the same way in a stock that reaches further to the left, so that the tiles' borders cross the cut elsewhere
    results = []
    for shift in (0, 240, 251):
        cut = small_cut(radius=9.3, shift=shift)
        forces = np.zeros((3000, 3))
        cut.sweep([1.613e-3, 1.721e-3, -5e-4], [2.717e-3, 2.519e-3, -5e-4], 0, 3000, forces)
        results.append((levels(cut), forces))
    for other_levels, other_forces in results[1:]:
        assert np.array_equal(other_levels, results[0][0])
        assert other_forces == pytest.approx(results[0][1], rel=1e-9, abs=1e-12)
    assert np.abs(results[0][1]).max() > 1.0
    a, b = small_cut(radius=9.0), small_cut(radius=9.0)
    start, end = np.array([-1e-3, 2e-3, -5e-4]), np.array([1e-3, 2e-3, -5e-4])
    mean = a.sweep(start, end, 0, 1200)
    parts = start + np.arange(101)[:, None] / 100 * (end - start)
    means = [b.sweep(parts[k], parts[k + 1], 12 * k, 12) for k in range(100)]
    assert np.count_nonzero(levels(a) != levels(b)) <= 2  # positions differ in the last digits
    assert np.mean(means, 0) == pytest.approx(mean, rel=0.01)


# --- The workpiece object: areas, undo, copies, tiles, export ---
FEED = 0.5e-3  # [m] per revolution
Z = -1e-3


def new_cut(size=(30e-3, 24e-3), grid_step=10e-6, law=PAPER_LAW, **kwargs):
    tool = Tool(diameter=20e-3, teeth=4, spindle_speed=837.0)
    low = np.array([0.0, -size[1] / 2, -5e-3])
    stock = Stock(min=low, max=np.array([size[0], size[1] / 2, 0.0]), grid_step=grid_step)
    return Cut(tool, law, stock, np.radians(1.0), **kwargs)


def test_restore_brings_back_the_very_same_grid_and_force_also_after_a_jump_to_a_deeper_level():
    cut, other = new_cut(), new_cut()
    here = np.array([-8e-3, 0.0, Z])
    for k in range(12):
        end = here + [24 * FEED / 360, 0.3e-6 * np.sin(k), 0.0]
        cut.sweep(here, end + [2e-6, 3e-6, -1e-6], 24 * k, 24)  # a first guess
        cut.restore()
        assert np.array_equal(cut.sweep(here, end, 24 * k, 24), other.sweep(here, end, 24 * k, 24))
        here = end
    cut.sweep(here, here + [3e-3, 5e-3, Z], 288, 30)
    assert not np.array_equal(cut.heights()[2], other.heights()[2])
    cut.restore()
    assert np.array_equal(cut.heights()[2], other.heights()[2])
    assert (cut.removed_area, cut.removed_volume) == (other.removed_area, other.removed_volume)
    assert cut.removed_area > 0


def test_a_sweep_without_room_in_the_log_cannot_be_taken_back_and_one_without_tiles_is_refused():
    a, b = new_cut(log_size=1024), new_cut()
    forces = [np.zeros((2880, 3)) for _ in range(2)]
    for cut, force in zip((a, b), forces, strict=True):
        cut.sweep([-10e-3, 0.0, Z], [-6e-3, 0.0, Z], 0, 2880, force)
    assert np.array_equal(*forces) and a.removed_volume == b.removed_volume > 0
    with pytest.raises(MillingError, match="1024"):
        a.restore()
    cut = new_cut()
    cut.state = cut.state._replace(pool=cut.state.pool[: 4 * TILE**2 + LANES].copy())
    with pytest.raises(MillingError, match="4 tiles"):
        cut.sweep([-10e-3, 0.0, Z], [10e-3, 0.0, Z], 0, 14400)


def test_a_course_is_swept_as_its_parts_are():
    whole, parts = new_cut(), new_cut()
    places = np.column_stack([np.linspace(-10e-3, -6e-3, 9), 1e-4 * np.arange(9.0), np.full(9, Z)])
    steps = 40 * np.arange(9)
    wrench, torque, volume = whole.along(places, steps)
    for k in range(1, 9):
        before = parts.removed_volume
        assert np.array_equal(parts.sweep(places[k - 1], places[k], steps[k - 1], 40), wrench[k])
        assert parts.torque == torque[k] and parts.removed_volume - before == pytest.approx(volume[k], rel=1e-9)
    assert not (wrench[0].any() or torque[0] or volume[0]) and volume[1:].min() > 0.0


def test_a_tool_that_sinks_cuts_with_its_whole_end_and_is_pushed_up_in_proportion_to_a_thin_layer():
    """N R s F_r(h) up, h = 2 pi v_z / (N omega); below the radius of the edge F_r of that in proportion: it damps.

    Teeth that find nothing on the floor and teeth that take a layer of the tolerance have the same mean.
    """
    cut = new_cut(law=Cutting(law="linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6)))
    radius, omega, speed, turns = 10e-3, cut.tool.spindle_speed, 1e-3, 10
    slight, law = cut.tool.edge_radius, cut.cutting.linear_edge
    middle = cut.stock.min[:2] + 0.5 * (cut.stock.max - cut.stock.min)[:2]
    end = np.array([*middle, Z - speed * turns * 2 * np.pi / omega])
    cut.sweep([*middle, Z], [*middle, Z], 0, 720)  # a hole as large as the tool
    sinking = cut.sweep([*middle, Z], end, 720, 360 * turns)[2]
    share = 2 * np.pi * speed / (4 * omega) / slight
    assert 0.3 < share < 1.0
    expected = 4 * radius * cut.cutting.end_share * share * (law.radial_cutting * slight + law.radial_edge)
    assert sinking == pytest.approx(expected, rel=0.05)
    rising = cut.sweep(end, [*middle, Z], 720 + 360 * turns, 720)[2]
    left = cut.stock.floor_tolerance / (speed * 2 * 2 * np.pi / omega)  # in two turns
    assert abs(rising) < left * abs(sinking) and left < 0.15


def test_memory_follows_the_area_cut():
    """A corner of a stock that as a whole would take 1.8 GB."""
    cut = new_cut(size=(300e-3, 300e-3))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cut.sweep([-10e-3, 0.0, Z], [20e-3, 0.0, Z], 0, 60 * 360)
    side = TILE * 10e-6
    assert cut.tiles <= (30e-3 + 2 * side) * (20e-3 + 2 * side) / side**2
    scale = 1024 if sys.platform == "linux" else 1
    used = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * scale
    assert used < cut.tiles * TILE**2 * 2 + 40e6


def test_heights_show_the_slot_thinned_and_in_a_window_and_of_a_narrow_sheet_a_row():
    cut = new_cut()
    cut.sweep([-10e-3, 0.0, Z], [10e-3, 0.0, Z], 0, 40 * 360)
    x, y, z = cut.heights(thinning=10)
    assert z.shape == (x.size, y.size) == (300, 240)
    inside = (x[:, None] < 10e-3) & (np.abs(y) < 9.9e-3)
    assert z[inside] == pytest.approx(Z, abs=cut.stock.level_step)
    assert np.all(z[:, np.abs(y) > 10.1e-3] == 0.0)
    x, y, z = cut.heights(low=[1e-3, -11e-3], high=[2e-3, -9e-3])
    assert (x.size, y.size) == (100, 200) and x[0] == pytest.approx(1.005e-3) and y[-1] == pytest.approx(-9.005e-3)
    assert np.count_nonzero(z[50]) == pytest.approx(100, abs=1)
    x, y, height = new_cut(size=(30e-3, 0.2e-3)).heights(thinning=100)
    assert height.shape == (x.size, 1) == (30, 1) and abs(y[0]) <= 0.1e-3 and np.all(height == 0.0)


def test_a_senseless_sweep_is_refused_and_absurd_positions_do_no_harm():
    cut = new_cut()
    for arguments in (([0, 0, np.nan], [0, 0, 0], 0, 1), ([0, 0], [0, 0], 0, 1), ([0] * 3, [0] * 3, -1, 1)):
        with pytest.raises(MillingError, match="a sweep from"):
            cut.sweep(*arguments)
    with pytest.raises(MillingError, match="a sweep from"):
        cut.sweep([0] * 3, [0] * 3, 0, 5, np.zeros((4, 3)))
    assert cut.removed_area == 0.0
    for far in (1e3, 1e30, 1e300):
        assert np.isfinite(cut.sweep([-1.0, 0, Z], [far, far, Z], 0, 3)).all()
        assert np.isfinite(cut.sweep([-1.0, 0, Z], [0.0, 0.0, -far], 3, 3)).all()
