"""The table of symbols: the paper's, and the words and names that stand for them here."""

__all__ = ["SYMBOLS"]

#: symbol, meaning, unit
SYMBOLS = (
    ("a_p", "depth of cut", "mm"),
    ("A_i", "area that tooth i removes in one micro-step", "mm²"),
    ("α", "relaxation of the iteration (32)", "–"),
    ("c, v, a, j", "value and derivatives of the correction at the start of a segment between two knots", "m … m/s³"),
    ("C_C", "Cartesian damping matrix, from one damping ratio for all modes", "N s/m"),
    ("d_0, d", "deviation of the tool from its path without and with a correction", "µm"),
    ("δt", "dynamic displacement (deflection) of the tool", "µm, rad"),
    ("F, w", "process force, wrench on the tool (forces before moments)", "N, N m"),
    ("F_c, F_t, F_r", "cutting force of one tooth; its tangential and radial part", "N"),
    ("f_y, v_fy", "shift of the reference across the feed, and its rate", "µm, mm/min"),
    ("f_z", "feed per tooth", "mm"),
    ("G_j", "auxiliary load at node j: link weights", "N"),
    ("h, h_s", "uncut chip thickness; specific chip thickness of the force law", "µm"),
    ("H", "exchange period between robot and cutting process", "ms"),
    ("H c", "response of the arm to the knots c of a correction, the lifted model: d = d_0 + H c", "µm"),
    ("H_θθ", "second derivatives of the load's work in the joint springs (15)", "N m/rad"),
    ("J_θ", "geometric Jacobian for the virtual joints", "m/rad, rad/rad"),
    ("k_0, k_∞, r", "slope of the force law for small and large chips; r = k_∞ / k_0", "N/m, –"),
    ("k_r", "radial to tangential force", "–"),
    ("K_C, K_θ", "Cartesian stiffness matrix (17); joint stiffness", "N/m; N m/rad"),
    ("M_C", "mass matrix at the tool (25)", "kg"),
    ("N_z, R, D", "number of teeth, radius and diameter of the tool", "–, mm"),
    ("Ω, φ_i", "spindle speed; angle of tooth i, clockwise from the feed direction", "rpm, deg"),
    ("q, θ", "joint positions; deflections of the virtual joint springs", "deg, rad"),
    ("r, z", "reference (motor side) and tool position: z / r = (2ζωs + ω²) / (s² + 2ζωs + ω²) per mode", "m"),
    ("t_0, t_F, t_0^(F)", "target, loaded and modified pose of the tool (30)–(32)", "m, rad"),
    ("u = p − q", "modal coordinate of the tool relative to that of the reference", "m √kg"),
    ("v_f", "feed rate", "m/min"),
    ("ω, ζ", "frequency and damping ratio of a mode of the arm", "rad/s, –"),
)
