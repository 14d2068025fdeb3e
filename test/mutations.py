"""Wrong signs and factors in the equations, each of which a test must detect: ``python test/mutations.py [TEXT]``.

Each mutation goes into a copy of the package; the tests of that part run until the first one fails. TEXT chooses
the mutations whose equation or file contains it. Exit code 1 if one survives. Takes about ten minutes.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]
LOADS, BALANCE = "physics/robot/loads.py", "physics/robot/elastostatics.py"
MASS, SWEEP = "physics/robot/mass.py", "physics/cutting/sweep.py"
LAWS = "physics/cutting/laws.py"
LOAD, REVOLUTION = "physics/cutting/load.py", "physics/cutting/revolution.py"
MOTION, MEASURED = "physics/motion/dynamics.py", "physics/motion/arm_model.py"
REVISION = "physics/compensation/revision.py"
RESPONSE, LIFTED = "physics/compensation/response.py", "physics/compensation/lifted.py"
LEARNING = "physics/compensation/learning.py"
IMPERFECTIONS, BACKLASH = "physics/motion/imperfections.py", "physics/motion/backlash.py"
TESTS = {
    LOADS: ["statics"], BALANCE: ["statics"], MASS: ["mass"], MEASURED: ["dynamics"], MOTION: ["dynamics"],
    LAWS: ["force"], LOAD: ["force"], SWEEP: ["force", "sweep"], REVISION: ["revision"], RESPONSE: ["lifted"],
    LIFTED: ["lifted"], LEARNING: ["compensator"], IMPERFECTIONS: ["plant"], BACKLASH: ["plant"],
    REVOLUTION: ["revolution"],
}  # fmt: skip

#: equation, file, a text that occurs once in the file, with <<old|new>>
MUTATIONS = [
    ("(1)", MOTION, "decay * (c <<+|->> z * w / damped * s), decay"),
    ("(1)", MOTION, "a21, a22 = <<-|+>>decay * w * w"),
    ("(1)", MOTION, "to * ((1.0 <<-|+>> a11) / w**2)"),
    ("(1)", MOTION, "(-<<a21|2 * a21>> / w**2)"),
    ("(1) condensed", MOTION, "output[..., free, :] = <<coupling|-coupling>>, coupling.swapaxes(-1, -2)"),
    ("(1) condensed", MOTION, "compliance[..., other, free] <<-|+>> compliance"),
    ("(1) -M r''", MOTION, "return <<-|>>np.concatenate([to * place @ back"),
    ("(1) ramp", MOTION, "ramp = (1.0 <<-|+>> a12 / h"),
    ("(1) ramp", MOTION, "a12 / h <<-|+>> 2.0 * z * (1.0 - a11)"),
    ("(1) ramp", MOTION, "(1.0 - a22 <<+|->> 2.0 * z * a21 / w)"),
    ("(1) falling", MOTION, "[constant <<-|+>> rising for"),
    ("(1) corner", MOTION, "response(<<a12|0 * a12>>, a22)"),
    ("(1) components", MOTION, "swapaxes(-1, -2) @ <<model.mass @ |>>model.reference  # eta -> delta, r -> eta"),
    ("(1) r'' at start", MOTION, "(6.0 * p / h - <<4.0|2.0>> * v"),
    ("(1) r'' at end", MOTION, "+ 2.0 * v + <<4.0|2.0>> * w) / h"),
    ("(1) corner", MOTION, "v <<-|+>> before[n, j]"),
    ("(1) approach", MOTION, "after[0] if approach is None else <<approach|after[0]>>"),
    ("(1) rest at the end", MOTION, "after[stamps <<>=|>>> reference.duration_ns] = 0.0"),
    ("(1) turning", MOTION, "(turned[1:] * turned[:-1]<<.inv()|>>)"),
    ("(1) turning", MOTION, "reference.turn(stamps, side)[<<2|1>>]"),
    ("(1) posture", MOTION, "out[step, i] += (r <<+|->> f * "),
    ("(7) weights", LOADS, "<<+|->> cross(masses, loads.gravity)"),
    ("(7) wrench", LOADS, "about_axis = cross(arms, force) <<+|->> moment"),
    ("(7) springs", BALANCE, "error = load_torque(frames, wrench[todo], loads, masses) - <<arm|2 * arm>>"),
    ("(7) split weights", LOADS, "arm.link_mass * (1 <<-|+>> arm.link_mass_centre)"),
    ("(8)", BALANCE, "<<target.position - frames.tool.position|frames.tool.position - target.position>>, turn]"),
    ("(9)", BALANCE, "balance = load_torque(frames, wrench, loads) <<-|+>> arm"),
    ("(10) F", BALANCE, "wrench[going] <<+=|-=>> change"),
    ("(10) theta", BALANCE, "theta[going] <<+=|-=>> change"),
    ("(14) force", LOADS, "cross(cross(axes, arms), <<force|-force>>) + weight"),
    ("(14) moment", LOADS, "out[p, k, i] <<+=|-=>> m[k, 0]"),
    ("(15) weights", LOADS, "force) <<+|->> weight"),
    ("(15) weights", LOADS, "weight = <<cross|2 * cross>>(cross(axes, masses"),
    ("(16)", BALANCE, "load_hessian(frames, wrench, loads) <<-|+>> np.diag"),
    ("(16)", BALANCE, "springs = np.diag(arm.spring_stiffness) - <<load|300 * load>>_hessian(frames, wrench[todo]"),
    ("(17) compliance", BALANCE, "equilibrium.jacobian\n    springs = np.diag(arm.spring_stiffness) <<-|+>> equ"),
    ("(17) stiffness", BALANCE, "equilibrium.jacobian)\n    springs = np.diag(arm.spring_stiffness) <<-|+>> equ"),
    ("(18) Q_j", MASS, "per_length, <<per_length / 2|per_length>>, per_length / 2"),
    ("(18) Q_j", MASS, "per_length = mass * radius**2 <</ length|>>"),
    ("(19) axial", MASS, "put(1, 1, m / <<3|2>>)"),
    ("(20) torsion", MASS, "put(4, 10, rho_i_p * l / <<6|3>>)"),
    ("(21) f", MASS, "put(1, 7, <<m|-m>> / 6)"),
    ("(21) g", MASS, "<<39 * m / 280|9 * m / 70>>"),
    ("(21) g", MASS, "<<33 * m / 140|13 * m / 35>>"),
    ("(21) h", MASS, "put(axis, axis + 6, <<2|-2>> * rho_i * l / 15)"),
    ("(22) D", MASS, "put(2, 6, <<3|-3>> * m * l / 35)"),
    ("(22) D", MASS, "put(5, 9, <<-11|11>> * m * l / 280)"),
    ("(23)", MASS, "<<2 * m|m>> * l**2 / 105"),
    ("(24)", MASS, "total[..., span, span] <<+=|=>> rotate_matrix"),
    ("(24) spindle", MASS, "total[..., 36:, 36:] <<+=|-=>> rotate_matrix"),
    ("(25)", MASS, "inverse = <<np.linalg.inv|np.array>>(jacobian)"),
    ("(25) base", MASS, "bent = arm.spring_compliance[:, None] <<*|/>> np.swapaxes"),
    ("(25) M_theta", MASS, "jacobian_at(frames, frames.nodes[..., j, :], <<j|6>>)"),
    ("rigid: tube across", MASS, "(length**2 / <<12|3>> + radius**2 / 2)"),
    ("rigid: tube across", MASS, "radius**2 / <<2|1>>)"),
    ("rigid: tube along", MASS, "return <<mass|2 * mass>> * radius**2 * along"),
    ("rigid: coupling", MASS, "out[..., :3, 3:] = <<mass|-mass>> * crossing"),
    ("rigid: Steiner", MASS, "inertia <<-|+>> mass * crossing @ crossing"),
    ("rigid: centre", MASS, "centre = start + <<arm.link_mass_centre[j]|0.5>> * "),
    ("rigid: spindle", MASS, "turn @ np.diag(<<mount.inertia|0 * mount.inertia>>)"),
    ("rigid: composite", MASS, "composite = <<composite + |>>body"),
    ("rigid: screws", MASS, "cross(frames.origins, <<frames|-frames>>.axes)"),
    ("measured modes", MEASURED, "output=<<shapes|-shapes>>"),
    ("measured modes", MEASURED, "damping=<<measured.damping_ratio|0 * measured.damping_ratio>>"),
    ("measured modes", MEASURED, "frequency=<<2|1>> * np.pi *"),
    ("measured modes", MEASURED, "np.linalg.pinv(<<weight[:, None] * |>>shapes)"),
    ("tool in series", MEASURED, "larger[:, order:, order:] = (1.0 - <<share|0.9 * share>>) * np.eye(3)"),
    ("tool in series", MEASURED, "np.eye(3) <<-|+>> axes[:, :, None] * axes[:, None, :]"),
    ("(26)", LAWS, "(u <<+|->> r * u * u) / (1.0 + u)"),
    ("(26)", LAWS, "(u + r * u * u) / (1.0 <<+|->> u)"),
    ("(26) reading", LAWS, "READING_DEPTH = <<1e-3|1.0>>"),
    ("(27)", LAWS, "u = <<np.maximum(h, 0.0)|h>> / h_s"),
    ("(27) linear edge", LAWS, "k_e * (h <<>|>=>> 0.0)"),
    ("(28)", LAWS, "return tangential, <<radial|-radial>>_ratio * tangential"),
    ("(29) F_x, F_r", LOAD, "force_x = share * (<<-|+>>f_r * c"),
    ("(29) F_x, F_t", LOAD, "-f_r * c <<+|->> p.sense * f_t * d"),
    ("(29) F_y, F_r", LOAD, "force_y = share * (<<-|+>>f_r * d"),
    ("(29) F_y, F_t", LOAD, "-f_r * d <<-|+>> p.sense * f_t * c"),
    ("axial force", LOAD, "force_z = <<-|>>share * f_a"),
    ("axial law", LAWS, "linear_edge(h, <<axial|radial>>_cutting, axial_edge)"),
    ("axial law", LAWS, "axial_ratio <<*|+>> tangential"),
    ("M_x", LOAD, "d * force_z <<-|+>> z * force_y"),
    ("M_y", LOAD, "now[4] += z * force_x <<-|+>> p.radii[i] * c * force_z"),
    ("M_z, reaction", SWEEP, "wrench[5] = <<-|>>p.sense * (sum_torque / n)"),
    ("helix: lag", LOAD, "length = <<height|2 * height>> * p.lag / p.radii[i]"),
    ("helix: height", LOAD, "height * place <</ length|>>)"),
    ("helix: hat", LOAD, "<<0.5|1.0>> * (1.0 + x) * (1.0 + x)"),
    ("helix: hat", LOAD, "abs(x) / <<3.0|2.0>>"),
    ("helix: undo", SWEEP, "copy_numbers(<<s.saved_loads[k], s.loads|s.loads[k], s.loads>>[k])"),
    ("dphi_i", SWEEP, "p.sense * (dy * c <<-|+>> dx * d)"),
    ("dphi_i", SWEEP, "along = <<p.sense|-p.sense>> * (dy"),
    ("dphi_i", SWEEP, "h /= max(<<1.0 + along|1.0>>, JUMP)"),
    ("h_i = A_i / (R dphi)", SWEEP, "(<<height|2 * height>> * p.radii[i] * p.micro_step)"),
    ("A_i", SWEEP, "total = s.tally[0] * (depth <<-|+>> level * p.level_step) + s.tally[1]"),
    ("torque", LOAD, "now[5] += share * (f_t <<*|+>> p.radii[i])"),
    ("revolution: F_x", REVOLUTION, "local_x + push * c <<+|->> pull * d"),
    ("revolution: F_y", REVOLUTION, "local_y + push * d <<-|+>> pull * c"),
    ("revolution: out", REVOLUTION, "out, up = -f_r * sine <<-|+>> f_a * cosine"),
    ("revolution: up", REVOLUTION, "f_r * cosine <<-|+>> f_a * sine"),
    ("revolution: h", REVOLUTION, "edge, h = whole * weight, (<<normal|2 * normal>> + place * spread) * each"),
    ("revolution: d.n", REVOLUTION, "normal = forward * sine <<-|+>> dz * cosine"),
    ("revolution: area", REVOLUTION, "piece[SINE_R] <<-|+>> dz * piece[COSINE_R]"),
    ("revolution: torque", REVOLUTION, "torque += f_t * edge * <<arm|lever>>"),
    ("(30)", REVISION, "commanded.position <<+ loaded.position - |- loaded.position + >>sagged.position"),
    ("(30) rotation", REVISION, "turned = <<loaded|sagged>>.rotation @ np.swapaxes(sagged.rotation, -1, -2)"),
    ("(30) weights", REVISION, "loaded = equilibrium(arm, mount, joints, wrench, gravity=<<True|False>>).pose"),
    ("(31)", REVISION, "shift = <<target.position - loaded.position|loaded.position - target.position>>"),
    ("(32)", REVISION, "modified.position <<+|->> relaxation * shift"),
    ("(32) alpha", REVISION, "modified.position + <<relaxation|2 * relaxation>> * shift"),
    ("(32) rotation", REVISION, "from_rotvec(<<relaxation|-relaxation>> * vector)"),
    ("Fig. 14", REVISION, "return <<-|>>record.sampled_displacement(reference, target.time_ns)"),
    ("z / r bend", RESPONSE, "return (h11 <<-|+>> 1.0) / w**2, of_jerk"),
    ("z / r jerk", RESPONSE, "of_jerk = (2.0 * z / w * (1.0 <<-|+>> h11)"),
    ("z / r corner", RESPONSE, "self.inward, before <<-|+>> cubic[:, 1])"),
    ("z / r damping", RESPONSE, "return cosine <<+|->> z * w * sine, sine"),
    ("delta = push / omega^2", RESPONSE, "added = np.stack([(1.0 <<-|+>> free[:, None, 0]) * static"),
    ("middle of a part", RESPONSE, "(start[:, 1] <<-|+>> end[:, 1]) / 8.0"),
    ("lifted stop", LIFTED, "from_state[k, j] = <<-|>>2.0 / time**2"),
    ("lifted corner", LIFTED, "from_state[corner, rate, v] = <<-|>>jump[corner]"),
    ("lifted cost to go", LIFTED, "linear[j] <<+|->>= policy[k, c, j] * gradient[size + c]"),
    ("lifted policy", LIFTED, "total[i, j] <<+|->>= total[i, size + c] * policy"),
    ("wrench on the path", LEARNING, "factor * (self._ideal <<-|+>> modelled)"),
    ("repeatability", IMPERFECTIONS, "np.sqrt(8.0 / np.pi) <<+|->> 3.0 * np.sqrt"),
    ("flank", BACKLASH, "lost = 0.5 * width[j] * (flank <<-|+>> first)"),
    ("friction", BACKLASH, "if torque < <<-|>>friction"),
]


def copy_into(folder: Path) -> None:
    """The package with its tests and configuration, without compiled code."""
    without = shutil.ignore_patterns("__pycache__", ".git", ".*_cache", ".hypothesis")
    for name in ("kr270_milling", "config", "test"):
        shutil.copytree(TOP / name, folder / name, ignore=without)
    for name in ("pyproject.toml", "setup.py", "package.xml"):  # a folder with these is a checkout
        shutil.copy(TOP / name, folder)


def run(folder: Path, tests: list[str], limit: float = 300.0) -> str:
    """Name of the first test that fails, "" if none does within a limit [s]."""
    files = [str(file.relative_to(folder)) for name in tests for file in folder.glob(f"test/**/test_{name}.py")]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-rfE", "-p", "no:cacheprovider", *files]
    environment = {**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return f"no end within {limit:g} s"
    failure = re.search(r"^(?:FAILED|ERROR) test/(\S+)", done.stdout, re.MULTILINE)
    return "" if done.returncode == 0 else failure.group(1) if failure else f"pytest ended with {done.returncode}"


def texts(pattern: str) -> tuple[str, str]:
    """Return the text in the file, and its replacement."""
    before, old, new, after = re.fullmatch(r"(.*?)<<(.*?)\|(.*?)>>(?!>)(.*)", pattern, re.DOTALL).groups()
    return before + old + after, before + new + after


def mutate(folder: Path, file: str, pattern: str) -> str:
    """First test that fails with the mutation, "" if it survives; afterwards the folder is restored."""
    (old, new), source = texts(pattern), folder / "kr270_milling" / file
    text = source.read_text()
    try:
        source.write_text(text.replace(old, new))
        forget_compiled(folder, text)
        return run(folder, TESTS[file])
    finally:
        source.write_text(text)
        forget_compiled(folder, text)


def forget_compiled(folder: Path, text: str) -> None:
    """Compiled functions keep what they call from other files: where that may have changed, all are made anew."""
    if "numba" in text or "compiled" in text:
        for cached in folder.rglob("*.nb[ci]"):
            cached.unlink()


def main(wanted: str) -> int:
    chosen, alive = [m for m in MUTATIONS if wanted in m[0] or wanted in m[1]], 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy_into(folder)
        broken = run(folder, sorted({t for m in chosen for t in TESTS[m[1]]}), 1800.0)  # compiles, and runs all
        if broken:
            print(f"without any mutation {broken} fails already")
            return 1
        for equation, file, pattern in chosen:
            killer = mutate(folder, file, pattern)
            alive += not killer
            print(f"{equation:20} {file:26} {pattern!r:80} {killer or 'SURVIVED'}", flush=True)
    print(f"{len(chosen)} mutations, {alive} survived")
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else ""))
