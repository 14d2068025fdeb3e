"""The compliance of the tool tip in the posture of a cell, and the deflection under 200 N across the feed."""

import numpy as np

from kr270_milling import read_cell
from kr270_milling.cell.models import arm_of
from kr270_milling.physics.robot import compliance, equilibrium, pose

cell = read_cell("paper.yaml")
posture = arm_of(cell).posture  # [rad], (6,)
force = np.array([0.0, 200.0, 0.0, 0.0, 0.0, 0.0])  # [N, N m], axes of base_link
rest = equilibrium(cell.arm, cell.mount, posture)
loaded = equilibrium(cell.arm, cell.mount, posture, force)
shift = loaded.pose.position - rest.pose.position
print("posture [deg]:", np.degrees(posture).round(2).tolist())
print("tool at [mm]:", (1e3 * pose(cell.arm, cell.mount, posture).position).round(2).tolist())
print("compliance along x, y, z [um/N]:", (1e6 * np.diag(compliance(rest, cell.arm))[:3]).round(4).tolist())
print("deflection [um]:", (1e6 * shift).round(2).tolist())
