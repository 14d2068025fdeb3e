"""Force and moment of a chip on the tool (29), also where a helix makes edges lag, and of the end edge; compiled."""

from __future__ import annotations

from kr270_milling.base.compiled import inlined
from kr270_milling.physics.cutting.force_law import forces_at


@inlined
def load(s, p, i, step, turn, h, height):
    """Add the load of a chip of tooth i to the micro-steps in which the edge cuts the chip; h, height [m].

    turn: ``step`` modulo a revolution.
    The tip cuts the chip in this micro-step. At z above the tip the edge reaches the same place, and so the same chip,
    lag z / R micro-steps later; the motion of the tool in between is neglected. A chip of height H is cut over
    H lag / R micro-steps; each gets a share of the height: the mean over that micro-step and over this one.
    """
    tangential, radial, axial = forces_at(p.law, h)
    f_t, f_r, f_a = tangential * height, radial * height, axial * height
    length = height * p.lag / p.radii[i]
    short = 1e-6  # [micro-steps]: a shorter lag changes the shares by less than its square
    if length < short:
        _add(s, p, i, turn, step, f_t, f_r, f_a, 1.0, 0.5 * height)
        return
    for later in range(int(length) + 2):
        share = (_hat(length - later) - _hat(0.0 - later)) / length
        if share > 0.0:
            place = later + (_hat_moment(length - later) - _hat_moment(0.0 - later)) / (length * share)
            _add(s, p, i, turn, step + later, f_t, f_r, f_a, share, height * place / length)


@inlined
def end_force(p, h):
    """Tangential and upward force on the end edge of a tooth per length of the radius [N/m]; h [m]: axial feed of it.

    The end edge lies across the axis, so the radial force of the law, which is normal to the edge, is the thrust:

        thrust = int s F_r(h) dr,   tangential force = int s F_t(h / s) dr,   torque = int s F_t(h / s) r dr

    r from 0 to R, s = ``cutting.end_share``. The share s of the edge that presses on the floor cuts the whole volume:
    with F_t = K_tc h the torque times the speed is K_tc dV/dt for any s. The force along the edge is left out.
    An edge that is round ploughs a layer thinner than ``p.edge_radius``: the force of that layer in proportion.
    """
    least, share = max(h, p.edge_radius), max(p.end_share, 1e-3)  # a share of 0.1 % bounds the thickness of its chip
    f_t = forces_at(p.law, least / share)[0]
    f_r = forces_at(p.law, least)[1]
    return h / least * share * f_t, h / least * p.end_share * f_r


@inlined
def _add(s, p, i, turn, when, f_t, f_r, f_a, share, z):
    """Add a share of the forces to micro-step ``when``, at z [m] above the tip, where tooth i was half way in ``turn``.

    F_x = sum(-F_r cos(phi) + F_t sin(phi)), F_y = sum(F_r sin(phi) + F_t cos(phi))   (29) [Klimchik2014], clockwise
    with the tooth at (cos(phi), -sin(phi)); M = r x F with r = (R c, R d, z), torque = F_t R.
    """
    c, d = p.middles[i, turn, 0], p.middles[i, turn, 1]
    force_x = share * (-f_r * c + p.sense * f_t * d)  # (29): -F_r along the tooth, -F_t along its motion
    force_y = share * (-f_r * d - p.sense * f_t * c)
    force_z = -share * f_a
    now = s.loads[when & (s.loads.shape[0] - 1)]
    now[0] += force_x
    now[1] += force_y
    now[2] += force_z
    if p.moments:
        now[3] += p.radii[i] * d * force_z - z * force_y  # r x F with r = (R c, R d, z)
        now[4] += z * force_x - p.radii[i] * c * force_z
    now[5] += share * (f_t * p.radii[i])


@inlined
def _hat(x):
    """Integral of the hat 1 - |x| from -1 to x."""
    if x <= -1.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    return 0.5 * (1.0 + x) * (1.0 + x) if x < 0.0 else 1.0 - 0.5 * (1.0 - x) * (1.0 - x)


@inlined
def _hat_moment(x):
    """Integral of x (1 - |x|) from -1 to x."""
    if x <= -1.0 or x >= 1.0:
        return 0.0
    return x * x * (0.5 - abs(x) / 3.0) - 1.0 / 6.0
