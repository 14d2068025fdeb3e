"""The force laws of many tests, the profile of a machined slot, and how fast the sweep of a rigid slot converges.

Two teeth in succession leave trochoids. With rho the distance from the centre to the earlier one along the tooth, and
v the feed, a tooth at phi removes A = ((R^2 - rho^2) / 2 - v sin(phi) / omega (R - rho)) dphi, and seen from where the
centre was it goes (R - v sin(phi) / omega) dphi. For small feeds h, the quotient, is f_z cos(phi).
"""

import math

import numpy as np

from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, FractionalLaw, Stock, Tool

KLIMCHIK2014 = FractionalLaw(5e6, 18e-6, 0.1, 0.3)  # section 6
PAPER_LAW = Cutting(fractional=KLIMCHIK2014)
ALUMINIUM = Cutting(law="linear_edge", linear_edge=AL7075_T6)
LAWS = {"fractional": PAPER_LAW, "linear_edge": ALUMINIUM}
#: the same for a command line, on a cell that has the other law
SET_ALUMINIUM = [
    "cutting.law=linear_edge", "cutting.linear_edge.tangential_cutting_n_per_mm2=600.46",
    "cutting.linear_edge.tangential_edge_n_per_mm=17.9", "cutting.linear_edge.radial_cutting_n_per_mm2=180.96",
    "cutting.linear_edge.radial_edge_n_per_mm=20.42",
]  # fmt: skip


def profile(cut) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x of each column that was cut (m,), its lowest and its highest cleared y (m,) [m]."""
    x, y, z = cut.heights()
    cleared = z < cut.stock.max[2]
    columns = cleared.any(axis=1)
    first, last = cleared[columns].argmax(axis=1), cleared[columns, ::-1].argmax(axis=1)
    return x[columns], y[first], y[::-1][last]


DEPTH = 1e-3  # [m] of the slots here


def slot_chip(tool: Tool, feed_per_tooth: float, phi: np.ndarray) -> np.ndarray:
    """Chip thickness [m] of a tooth at phi [rad] in a full slot fed along +x; uniform pitch, no run-out."""
    radius, pitch = tool.radius, 2 * np.pi / tool.teeth
    drift = feed_per_tooth / pitch  # of the centre [m/rad]
    phi = (np.asarray(phi, float) + np.pi) % (2 * np.pi) - np.pi
    psi = phi.copy()  # where the tooth ahead was when it passed this direction
    # its centre lay ``way`` behind; the sine rule in the triangle of both centres and the point
    for _ in range(15):  # each round leaves some f / R of the error
        way = drift * (pitch + phi - psi)
        psi = phi - np.arcsin(way * np.sin(phi) / radius)
    rho = radius * np.cos(psi - phi) - way * np.cos(phi)
    area = (radius**2 - rho**2) / 2 - drift * np.sin(phi) * (radius - rho)
    return np.where(rho < radius, area / (radius - drift * np.sin(phi)), 0.0)


def slot_force(tool: Tool, cutting: Cutting, feed_per_tooth: float, phi: np.ndarray) -> np.ndarray:
    """Force (phi.size, 2) [N] on a rigid tool with tooth 0 at phi in a slot of DEPTH, by (29)."""
    angles = np.asarray(phi)[:, None] + 2 * np.pi / tool.teeth * np.arange(tool.teeth)
    tangential, radial = cutting.force_per_depth(slot_chip(tool, feed_per_tooth, angles))
    force_x = (-radial * np.cos(angles) + tangential * np.sin(angles)).sum(1)
    force_y = (radial * np.sin(angles) + tangential * np.cos(angles)).sum(1)
    return DEPTH * np.stack([force_x, -tool.sense * force_y], -1)


def slot_errors(tool: Tool, cutting: Cutting, feed_per_tooth: float, grid_step: float, micro_step: float):
    """Error of the mean force and rms error of the force of a micro-step over two revolutions, both per mean force."""
    radius, feed = tool.radius, tool.teeth * feed_per_tooth
    lead = math.ceil(1.2 * radius / feed)  # revolutions until the tool is fully engaged
    corner = np.array([0.0, -radius - 1e-3, -2 * DEPTH])
    stock = Stock(min=corner, max=np.array([1.3 * radius + 4 * feed, radius + 1e-3, 0.0]), grid_step=grid_step)
    cut = Cut(tool, cutting, stock, micro_step)
    steps = cut.params.steps
    start, middle = np.array([-radius - 0.1 * feed, 0.0, -DEPTH]), np.array([feed, 0.0, 0.0])
    cut.sweep(start, start + lead * middle, 0, lead * steps)
    forces = np.zeros((2 * steps, 3))
    cut.sweep(start + lead * middle, start + (lead + 2) * middle, lead * steps, 2 * steps, forces)
    phi = tool.start_angle + (np.arange(2 * steps) + 0.5) * micro_step
    exact = slot_force(tool, cutting, feed_per_tooth, phi)
    turn = np.linspace(0, 2 * np.pi, 36000, endpoint=False)
    mean = slot_force(tool, cutting, feed_per_tooth, turn).mean(0)
    scale = np.linalg.norm(mean)
    mean_error = np.linalg.norm(forces[:, :2].mean(0) - mean) / scale
    return mean_error, np.sqrt(((forces[:, :2] - exact) ** 2).sum(1).mean()) / scale


def fitted_order(steps, errors) -> float:
    """Slope of log(error) over log(step)."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def convergence(tool: Tool, cutting: Cutting, feed_per_tooth: float = 0.1237e-3) -> tuple[float, float, float]:
    """Order of the rms force in the grid step, order of the mean force in the angle step, and its largest error."""
    grid = [40e-6, 20e-6, 10e-6, 5e-6]  # [m], at 1 deg
    angle = [15.0, 10.0, 7.5, 5.0]  # [deg], parts of a quarter turn, so that entry and exit fall alike; at 5 um
    by_grid = [slot_errors(tool, cutting, feed_per_tooth, g, math.radians(1.0))[1] for g in grid]
    by_angle = [slot_errors(tool, cutting, feed_per_tooth, 5e-6, math.radians(a))[0] for a in angle]
    return fitted_order(grid, by_grid), fitted_order(angle, by_angle), max(by_angle)
