"""The text of a first parameter file; values of ``config/test_piece.yaml`` where nobody knows better."""

from __future__ import annotations

__all__ = ["TEMPLATE"]

TEMPLATE = """\
# A first cell for a program, to be completed: every line with "yours:" is a guess. {operations}
# kr270_milling keys SECTION lists every key with unit, range, default and meaning.
/**:
  ros__parameters:
    includes: ["{robot}"]                # yours: the arm with its compliances, measured on your robot
    posture_hint_deg: [2.0, -87.0, 137.0, 0.0, -50.0, 2.0]   # yours: near the joints that cut; chooses the branch

    mount:                               # flange -> tool0
      xyz_mm: [140.0, 0.0, -300.0]       # yours: tip of the tool, flange frame
      abc_deg: [0.0, 0.0, 180.0]         # yours: tool0 z along the spindle axis away from the flange
      mass_kg: 45.0                      # yours: spindle, adapter, holder
      mass_centre_mm: [130.0, 0.0, -60.0]   # yours

    workpiece:                           # zero of the program ({offset}) on base_link
      xyz_mm: {place}       # yours: measured; here the place of the shipped test piece
      abc_deg: [0.0, 0.0, 0.0]           # yours: x away from the arm, z up

    tool:
      diameter_mm: {diameter}            # {diameter_source}
      teeth: {teeth}                     # {teeth_source}
      rotation: {rotation}               # M3: clockwise, M4: counterclockwise
      {speed}                            # {speed_source}

    cutting:
      law: linear_edge
      linear_edge:                       # yours: here Al7075-T6 [source: Chinese Journal of Mech. Eng., table 5]
        tangential_cutting_n_per_mm2: 600.46
        tangential_edge_n_per_mm: 17.9
        radial_cutting_n_per_mm2: 180.96
        radial_edge_n_per_mm: 20.42

    stock:                               # in the frame of the program
      min_mm: {low}        # yours: here the box of the path, the cutter and 5 mm
      max_mm: {high}
      grid_step_um: {grid}               # up to half the feed per tooth, or what a large stock needs
      floor_tolerance_um: 1.0

    path:
{path}

    dynamics:
      mass_model: rigid
      damping_ratio: 0.04                # yours: milling robots have 0.02 to 0.05
      gravity: true
      follow_pose: true
      posture_spacing_mm: {spacing}

    exchange:
      period_ms: {period}                # {steps} micro-steps at the spindle speed
      micro_step_deg: 1.0

    timing:
      controller_step_ms: 12.0           # yours: KUKA RSI corrects every 12 ms or 4 ms
      acceleration_m_per_s2: 2.0         # yours
      jerk_m_per_s3: 40.0                # yours
      rapid_feed_m_per_min: 12.0         # yours
      corner_tolerance_um: 10.0          # yours

    compensation:
      method: learned                    # the model of the test piece says: the best; linear, spline harm
      relaxation: 0.9
      sag_compensated: true              # yours: true where the tool is zeroed on the part
      criterion: least_squares
      max_passes: 6
      max_correction_mm: 0.5             # yours

    part:
      tolerance_um: 100.0                # yours: what wall and floor may be wrong by
"""
