"""Straight cuts of a cutter of revolution, upright and tilted, and the quadrature of the mean force over its edge.

The quadrature needs no map: a convex tool on a straight way first meets each point of the material with the part of its
surface where d.n > 0. It sums the law over all such places inside the stock.
"""

import math

import numpy as np
from samples.cuttings import LAWS

from kr270_milling.physics.cutting import AL7075_T6, Cutting, EngagementCut, Stock, Tool

RADIUS, TEETH, FEED = 5e-3, 4, 0.125e-3  # [m]; feed per tooth
SPEED = 8000.0 * math.pi / 30.0  # [rad/s]
VELOCITY = FEED * TEETH * SPEED / (2.0 * math.pi)
MICRO_STEP = math.radians(1.0)
SHARP = Cutting("linear_edge", linear_edge=AL7075_T6.replace(tangential_edge=0.0, radial_edge=0.0), end_share=1.0)
EDGE = Cutting("linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6, axial_edge=2e3), end_share=1.0)
CUTTINGS = {"sharp": SHARP, "edge": EDGE, "fractional": LAWS["fractional"].replace(end_share=1.0)}
FLAT = Tool(diameter=2 * RADIUS, teeth=TEETH, spindle_speed=SPEED)
TOOLS = {
    "flat": FLAT.replace(type="points", profile=np.array([RADIUS, 0.0])),
    "ball": FLAT.replace(type="ball"),
    "bull": FLAT.replace(type="bull_nose", corner_radius=1e-3),
    "taper": FLAT.replace(type="tapered", taper=math.radians(20.0), tip_diameter=4e-3),
    "point": FLAT.replace(type="tapered", taper=math.radians(45.0)),
}


def axis_of(tilt) -> np.ndarray:
    """Return the axis of a tool that leads along x and leans to y by two angles [deg]."""
    lead, lean = np.radians(tilt)
    return np.array([math.sin(lead), math.cos(lead) * math.sin(lean), math.cos(lead) * math.cos(lean)])


def edge(tool: Tool, sigma=None) -> tuple[np.ndarray, ...]:
    """Radius, height, kappa and length [m], [rad] of small pieces of the edge, and of 15 mm of the cylinder.

    sigma: their middles, at equal distances along the edge [m].
    """
    corner = {"ball": RADIUS, "bull_nose": tool.corner_radius}.get(tool.type, 0.0)
    taper = tool.taper if tool.type == "tapered" else 0.0
    tip = tool.tip_diameter / 2 if taper else RADIUS - corner
    lengths = [tip, corner * math.pi / 2, (RADIUS - tip) / math.sin(taper) if taper else 0.0, 15e-3]
    if sigma is None:
        sigma = (np.arange(2000) + 0.5) * sum(lengths) / 2000
    starts = np.cumsum([0.0, *lengths[:-1]])
    end, arc, cone, side = (np.clip(sigma - start, 0.0, length) for start, length in zip(starts, lengths, strict=True))
    turn = arc / max(corner, 1e-12)
    kappa = np.where(side > 0.0, math.pi / 2, np.where(cone > 0.0, math.pi / 2 - taper, turn))
    r = end + corner * np.sin(turn) + cone * math.sin(taper)
    h = corner * (1.0 - np.cos(turn)) + cone * math.cos(taper) + side
    return r, h, kappa, np.full(sigma.size, sigma[1] - sigma[0])


def quadrature(tool: Tool, cutting: Cutting, axis, move, passes: float, inside, turns: int = 300):
    """Mean force (3,) [N] and torque [N m]; inside(points) [m]: whether places from the tip are in the stock.

    The places are ``turns`` angles of as many pieces of the edge, in a box about the places that cut, which twice as
    many find. A strip of 5 % is some 0.5 mm of the edge: pieces of a fixed length of 5 um had 0.8 % too little of it.
    """
    ahead = move - np.dot(move, axis) * axis
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-12 else np.array([axis[2], 0.0, -axis[0]])
    side = np.cross(axis, ahead)
    low, high = np.array([0.0, -math.pi]), np.array([edge(tool)[3].sum(), math.pi])
    for count in (2 * turns, turns // 2, turns):
        sigma, phi = (a + (np.arange(count) + 0.5) / count * (b - a) for a, b in zip(low, high, strict=True))
        r, h, kappa, length = (column[:, None] for column in edge(tool, sigma))
        out = np.cos(phi)[:, None] * ahead + np.sin(phi)[:, None] * side
        normal = np.sin(kappa)[..., None] * out - np.cos(kappa)[..., None] * axis
        feed = normal @ move
        cuts = (feed > 1e-12) & inside(r[..., None] * out + h[..., None] * axis)
        met = [np.flatnonzero(cuts.any(axis=1 - k)) for k in range(2)]
        width = (high - low) / count
        low, high = (
            np.maximum([low[k] + (met[k][0] - 1) * width[k] for k in range(2)], low),
            np.minimum([low[k] + (met[k][-1] + 2) * width[k] for k in range(2)], high),
        )
    f_t, f_r, f_a = np.where(cuts, cutting.active.per_depth(np.where(cuts, feed, 1e-9) / passes), 0.0)
    f_a = np.where(kappa == 0.0, 0.0, f_a)  # the force along an end edge is left out
    weight = TEETH / (2.0 * math.pi) * (phi[1] - phi[0]) * length
    along = -np.cos(kappa)[..., None] * out - np.sin(kappa)[..., None] * axis  # towards the tip
    tooth = tool.sense * np.cross(axis, out)
    force = -f_t[..., None] * tooth - f_r[..., None] * normal + f_a[..., None] * along
    return (weight[..., None] * force).sum(axis=(0, 1)), float((weight * f_t * r).sum())


def lowest(tool: Tool, axis) -> float:
    """Return the height of the lowest point of a tilted tool above its tip [m]."""
    r, h, _, _ = edge(tool)
    return float(min(0.0, np.min(h * axis[2] - r * math.hypot(*axis[:2]))))


def swept_widths(tool: Tool, depth: float, tilt) -> tuple[float, float]:
    """Return the least and largest y that a tool cuts below the top on its way along x [m], on the nodes of the map."""
    axis = axis_of(tilt)
    r, h = (column[:, None] for column in edge(tool)[:2])
    phi = np.linspace(-math.pi, math.pi, 721)
    first = np.array([axis[2], 0.0, -axis[0]]) / math.hypot(axis[0], axis[2])
    second = np.cross(axis, first)
    places = r[..., None] * (np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * second) + h[..., None] * axis
    y = places[..., 1][places[..., 2] < depth + lowest(tool, axis)]
    return float(np.round(y.min(), 4)), float(np.round(y.max(), 4))


def measured(tool: Tool, cutting: Cutting, tilt, sides, depth=2e-3, dt=4e-3, grid_step=1e-4, bins=72):
    """Mean force and torque of the kernel and of the quadrature, where the tool is fully engaged.

    sides: y of the borders of the stock [m]; depth [m]: of the lowest point of the tool below the top.
    """
    axis, n = axis_of(tilt), round(SPEED * dt / MICRO_STEP)
    stock = Stock(min=np.array([0.0, sides[0], -12e-3]), max=np.array([32e-3, sides[1], 0.0]), grid_step=grid_step)
    cut = EngagementCut(tool, cutting, stock, MICRO_STEP, bins, tilts=any(tilt), upright=not any(tilt))
    step = VELOCITY * n * MICRO_STEP / SPEED
    x = np.arange(-3.0 * RADIUS, 18e-3, step)
    path = np.column_stack([x, 0.0 * x, 0.0 * x - depth - lowest(tool, axis)])
    wrench, torque, _ = cut.along(path, n * np.arange(x.size), axes=np.tile(axis, (x.size, 1)))
    chosen, z = x > 12e-3, path[0, 2]

    def inside(places):
        return (places[..., 2] + z < 0.0) & (places[..., 1] > sides[0]) & (places[..., 1] < sides[1])

    passes = n * MICRO_STEP * TEETH / (2 * math.pi)
    exact = quadrature(tool, cutting, axis, np.array([step, 0.0, 0.0]), passes, inside)
    return (wrench[chosen, :3].mean(axis=0), torque[chosen].mean()), exact


def ramp_error(tool: Tool, cutting: Cutting, tilt, slope: float, dt=4e-3) -> float:
    """Return the error of the mean force, a share of its size, of a slot that falls by a slope [deg]; 90: a plunge.

    The lowest point of the tool is within 1 mm of a depth of 2 mm.
    """
    axis, n, side = axis_of(tilt), round(SPEED * dt / MICRO_STEP), 12e-3
    stock = Stock(min=np.array([0.0, -side, -14e-3]), max=np.array([40e-3, side, 0.0]), grid_step=1e-4)
    cut = EngagementCut(tool, cutting, stock, MICRO_STEP, tilts=any(tilt), upright=not any(tilt))
    size, down = VELOCITY * n * MICRO_STEP / SPEED, math.radians(slope)
    step = size * np.array([math.cos(down), 0.0, -math.sin(down)])
    way = np.arange(-12e-3, 1e-3, size)
    path = np.array([20e-3, 0.0, -2e-3 - lowest(tool, axis)]) + way[:, None] * step / size
    wrench, _, _ = cut.along(path, n * np.arange(way.size), axes=np.tile(axis, (way.size, 1)))
    chosen, exact = np.flatnonzero(way > -1e-3), []
    lag = 0.5 + math.pi / TEETH / (n * MICRO_STEP)  # the middle of a step, and half a pitch of the teeth
    for place in (np.arange(6) + 0.5) / 6 * chosen.size - 0.5:
        tip = path[chosen[0]] + (place - lag) * step

        def inside(places, z=tip[2]):
            return (places[..., 2] + z < 0.0) & (np.abs(places[..., 1]) < side)

        passes = n * MICRO_STEP * TEETH / (2 * math.pi)
        exact.append(quadrature(tool, cutting, axis, step, passes, inside, turns=240)[0])
    force, mean = wrench[chosen, :3].mean(axis=0), np.mean(exact, axis=0)
    return float(np.abs(force - mean).max() / np.linalg.norm(mean))


def bore_error(tool: Tool, cutting: Cutting, around=2e-3, pitch=1e-3, dt=4e-3) -> float:
    """Return the error of the mean force, a share of its size, of an upright tool in a helical bore.

    around [m]: radius of the helix; pitch [m]: fall in a turn. A place is in the stock where no earlier pose of the
    last turn covers it. The force turns with the tool, and the quadrature has it in the frame of the move.
    """
    n, rate = round(SPEED * dt / MICRO_STEP), VELOCITY * dt / around
    stock = Stock(min=np.array([-11e-3, -11e-3, -12e-3]), max=np.array([11e-3, 11e-3, 0.0]), grid_step=1e-4)
    cut, turned = EngagementCut(tool, cutting, stock, MICRO_STEP), np.arange(-0.5, 6.0 * math.pi, rate)
    fall = pitch / (2.0 * math.pi)
    path = np.column_stack([around * np.cos(turned), around * np.sin(turned), -3.5e-3 - fall * turned])
    wrench, _, _ = cut.along(path, n * np.arange(turned.size))
    lag, passes = 0.5 + math.pi / TEETH / (n * MICRO_STEP), n * MICRO_STEP * TEETH / (2.0 * math.pi)
    angle, chosen = turned - lag * rate, turned > 4.0 * math.pi
    ahead = np.column_stack([-np.sin(angle), np.cos(angle)])
    seen = [(wrench[:, :2] * ahead).sum(1), ahead[:, 0] * wrench[:, 1] - ahead[:, 1] * wrench[:, 0], wrench[:, 2]]
    force = np.mean(np.stack(seen, -1)[chosen], axis=0)
    (r, h, _, _), top = edge(tool), -path[chosen, 2].mean() - fall * lag * rate

    def inside(places):
        fresh = places[..., 2] < top
        for back in np.radians(np.arange(4.0, 364.0, 4.0)):  # earlier tips from the present one, which moves along x
            x, y = -around * math.sin(back), around * (math.cos(back) - 1.0)
            up = places[..., 2] - fall * back
            fresh &= ~((up > 0.0) & (np.hypot(places[..., 0] - x, places[..., 1] + y) < np.interp(up, h, r)))
        return fresh

    step = np.array([VELOCITY * dt, 0.0, -fall * rate])
    exact, _ = quadrature(tool, cutting, np.array([0.0, 0.0, 1.0]), step, passes, inside, turns=240)
    return float(np.abs(force - exact).max() / np.linalg.norm(exact))


def error(*arguments, **options) -> float:
    """Return the error of the mean force, a share of its size."""
    (force, _), (exact, _) = measured(*arguments, **options)
    return float(np.abs(force - exact).max() / np.linalg.norm(exact))
