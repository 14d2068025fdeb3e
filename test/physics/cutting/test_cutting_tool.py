"""The cutter's record and the tables that the sweep makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from cuttings import PAPER_LAW

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.record import build
from kr270_milling.physics.cutting import Stock, Tool, make_params

PAPER = {"diameter_mm": 20.0, "teeth": 4, "spindle_speed_rpm": 8000.0}
STOCK = Stock(min=np.zeros(3), max=np.array([10e-3, 5e-3, 2e-3]))


def test_paper_cutter_has_four_teeth_a_quarter_turn_apart():
    tool = build(Tool, PAPER)
    assert tool.angles == pytest.approx(np.radians([0, 90, 180, 270]))
    assert tool.radii == pytest.approx(np.full(4, 10e-3))
    assert tool.spindle_speed == pytest.approx(837.758, abs=1e-3)


def test_pitch_angles_add_up_in_the_sense_of_rotation():
    tool = build(Tool, {**PAPER, "teeth": 3, "pitch_deg": [100.0, 110.0, 150.0], "start_angle_deg": 10.0})
    assert tool.angles == pytest.approx(np.radians([10, 110, 220]))


def test_clockwise_teeth_stand_at_cos_phi_minus_sin_phi():
    for rotation, sense in (("clockwise", -1), ("counterclockwise", 1)):
        params = make_params(build(Tool, {**PAPER, "rotation": rotation}), PAPER_LAW, STOCK, np.radians(1.0))
        assert params.directions[0, 30] == pytest.approx([np.cos(np.pi / 6), sense * 0.5])
        assert params.directions[1, 0] == pytest.approx([0.0, sense], abs=0)
        assert np.array_equal(params.directions[:, 0], params.directions[:, -1])


@pytest.mark.parametrize(
    "change",
    [
        {"pitch_deg": [90.0, 90.0, 90.0]},
        {"pitch_deg": [90.0, 90.0, 90.0, 91.0]},
        {"pitch_deg": [90.0, 90.0, 180.0, 0.0]},
        {"runout_um": [1.0]},
        {"diameter_mm": 1.0, "runout_um": [0.0, 0.0, 0.0, -600.0]},
        {"teeth": 0},
        {"rotation": "left"},
        {"diameter_mm": float("nan")},
    ],
)
def test_impossible_cutters_are_refused(change):
    with pytest.raises(ConfigError):
        build(Tool, {**PAPER, **change})


@pytest.mark.parametrize("degrees", [0.0, -1.0, 0.7, 16.0, float("nan")])
def test_a_micro_step_must_divide_a_revolution(degrees):
    with pytest.raises(ParameterError, match="micro_step"):
        make_params(build(Tool, PAPER), PAPER_LAW, STOCK, np.radians(degrees))
    assert make_params(build(Tool, PAPER), PAPER_LAW, STOCK, np.radians(0.75)).steps == 480
