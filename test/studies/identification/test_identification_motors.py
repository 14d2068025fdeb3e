"""Servo lag and backlash: closed forms, coverage of the intervals, tables that must not be used, and the commands."""

import dataclasses

import numpy as np
import pytest
from hostile import printed
from scipy import signal
from scipy.stats import binom

from kr270_milling.base.errors import InputError
from kr270_milling.base.parameter_file import find_file, read_tree
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.plant import perturbed
from kr270_milling.live.rsi.corrector import read_corrections
from kr270_milling.live.rsi.session import RsiRecording
from kr270_milling.physics.motion.backlash import flank_after
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.kinematics import forward, jacobian_at
from kr270_milling.physics.robot.loads import link_loads, load_torque
from kr270_milling.studies.identification import play, servo

MM = 1e3
ARCSEC = np.pi / 648000


def follow(time, commanded, frequency, damping, delay):
    """The response of the second order after a dead time, by scipy.signal on a grid of 0.1 ms."""
    w, fine = 2 * np.pi * frequency, np.arange(time[0], time[-1] + 1e-9, 1e-4)
    system = [w * w], [1.0, 2 * damping * w, w * w]
    return np.interp(time, fine, signal.lsim(system, np.interp(fine - delay, time, commanded), fine)[1])


@pytest.fixture(scope="module")
def sweep():
    time, shift = servo.test_move()
    return time, MM * shift


def test_the_test_move_rests_at_both_ends_and_respects_its_limits(sweep):
    time, shift = sweep
    assert np.abs(shift[time < 1.0]).max() == 0.0 == pytest.approx(np.abs(shift[-200:]).max(), abs=1e-12)
    assert np.abs(shift).max() <= 0.3 + 1e-9 and np.abs(np.diff(shift, 2)).max() / MM / 4e-3**2 < 1.1
    assert np.abs(np.diff(shift)).max() / 4e-3 < 20.0  # mm/s, that ``rsi`` follows by default


def test_a_step_without_noise_gives_the_numbers_of_the_closed_form():
    """y = 1 - exp(-z w t) (cos(w_d t) + z w / w_d sin(w_d t)); the step is a ramp of one sample."""
    w, z, delay, step = 2 * np.pi * 12.0, 0.5, 0.020, 1e-3
    time = step * np.arange(1000)
    t, d = np.maximum(time - 0.2995 - delay, 0.0), w * np.sqrt(1 - z * z)
    moved = 1 - np.exp(-z * w * t) * (np.cos(d * t) + z * w / d * np.sin(d * t))
    fitted = servo.fit_servo(servo.Move(step, (time >= 0.3).astype(float), 0.7 + 0.01 * time + 1.02 * moved))
    numbers = fitted.frequency, fitted.damping, fitted.delay, fitted.gain
    assert numbers == pytest.approx((12.0, z, delay, 1.02), rel=2e-3)


def test_the_intervals_contain_nine_of_ten_hidden_lags_and_more(sweep):
    """95 % of 8 robots with three numbers each; four standard deviations of the binomial distribution."""
    rng, hits, robots = np.random.default_rng(3), 0, 5
    time, shift = sweep
    for _ in range(robots):
        true = rng.uniform((10.0, 0.4, 0.0), (35.0, 1.0, 0.012))
        measured = follow(time, shift, *true) + rng.uniform(1e-3, 5e-3) * rng.standard_normal(len(time))
        fitted = servo.fit_servo(servo.Move(4e-3, shift, measured))
        values = fitted.frequency, fitted.damping, fitted.delay
        hits += np.sum(
            np.abs(np.subtract(values, true)) <= (fitted.frequency_half, fitted.damping_half, fitted.delay_half)
        )
    assert abs(hits - 0.95 * 3 * robots) <= 4 * binom.std(3 * robots, 0.95)


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda t, c, y: (c, -y), "is -1 times the commanded one"),
    (lambda t, c, y: (c, 25.4 * y), "unit, sign or direction?"),
    (lambda t, c, y: (np.interp(t - 0.03, t, c), c), "before the commanded one"),
    (lambda t, c, y: (c, y + 0.1 * np.sin(40 * t)), "% of the measured motion unexplained"),
    (lambda t, c, y: (c * (t < 2), y * (t < 2) + 0.05 * np.random.default_rng(1).normal(size=len(t))),
     "does not show the frequency"),
    (lambda t, c, y: (c, c), "faster than samples every 4 ms show"),
])  # fmt: skip
def test_a_series_that_shows_no_lag_writes_no_file_and_names_the_reason(sweep, spoil, words):
    time, shift = sweep
    move = servo.Move(4e-3, *spoil(time, shift, follow(time, shift, 18.0, 0.7, 0.008)))
    doubts = servo.identified_servo(move)[1]
    assert any(doubt.forbids and words in doubt.text for doubt in doubts)


@pytest.fixture(scope="module")
def table(sweep, tmp_path_factory):
    time, shift = sweep
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(time))
    rows = np.column_stack([time, shift, follow(time, shift, 18.0, 0.6, 0.006) + noise])
    path = tmp_path_factory.mktemp("servo") / "move.csv"
    np.savetxt(path, rows, "%.6f", ",", header="time_s,commanded_mm,measured_mm", comments="")
    return path


def test_the_command_writes_keys_with_which_every_robot_has_the_lag(table, tmp_path, capsys):
    _, text, values, _ = printed(capsys, "identify", "servo", str(table), "--out", str(tmp_path / "out"))
    assert "dead time [ms]" in text and values["usable"] and values["frequency_hz"] == pytest.approx(18.0, rel=5e-3)
    (tmp_path / "cell.yaml").write_text(
        f'/**:\n  ros__parameters:\n    includes: ["test_piece.yaml", "{tmp_path}/out/servo.yaml"]\n'
    )
    cell, rng = read_cell(tmp_path / "cell.yaml"), np.random.default_rng(1)
    for robot in (perturbed(cell, rng).imperfections for _ in range(3)):
        drawn = robot.servo_frequency, robot.servo_damping, 1e3 * robot.servo_delay
        assert drawn == pytest.approx((18.0, 0.6, 6.0), rel=0.02)
    printed(capsys, "identify", "servo", str(table), "--other-clock", "--out", str(tmp_path / "late"))
    assert "servo_delay_ms" not in (tmp_path / "late/servo.yaml").read_text()


@pytest.mark.parametrize(("head", "rows", "words"), [
    ("time_s,commanded_mm,measured_deg", ["0,0,0"], "needs the columns commanded_mm and measured_mm"),
    ("time_s,commanded_mm,measured_mm", [f"{k},0,0" for k in range(200)], "does not move"),
    ("time_s,commanded_mm,measured_mm", [f"{k / 1e3},{k},{k}" for k in range(200)], "begin the record before the move"),
    ("time_s,commanded_mm,measured_mm", [f"{k},0,0" for k in range(20)], "needs at least 100"),
    ("time_s,commanded_mm,measured_mm", [f"{-k},0,0" for k in range(200)], "the time goes back"),
])  # fmt: skip
def test_a_table_that_is_no_test_move_is_refused_in_a_sentence(tmp_path, head, rows, words):
    (tmp_path / "bad.csv").write_text("\n".join([head, *rows]))
    with pytest.raises(InputError, match=words):
        servo.read_move(tmp_path / "bad.csv")


def test_the_planned_move_is_written_for_both_controllers_and_its_recording_is_read(sweep, tmp_path, capsys):
    """The recording of a robot that follows the table of RSI with 15 Hz and 8 ms, along the slow line."""
    with pytest.raises(InputError, match="needs --cell"):
        printed(capsys, "identify", "servo", "--plan")
    words = "identify", "servo", "--plan", "--cell", "test_piece.yaml", "--rsi", "192.168.1.10", "--out", str(tmp_path)
    _, text, values, _ = printed(capsys, *words)
    programs = values["programs"]
    assert {"krl_spline", "rsi", "rsi_context"} <= set(programs) and "SERVOTEST_CMP" in text
    corrections = read_corrections(programs["rsi"][0])
    time, wanted = corrections.time, corrections.correction[:, 1]
    assert wanted == pytest.approx(1e-3 * np.interp(time, *sweep), abs=1e-9)
    moved = follow(time, wanted, 15.0, 0.7, 0.008)
    with RsiRecording(tmp_path / "session", corrections, {}, {}, lambda: 1) as recording:
        for k in range(len(time)):
            place = corrections.position[k] + (0.0, moved[k], 0.0)
            recording.add(int(1e9 * time[k]), np.append(place, np.zeros(3)), corrections.correction[k])
    fitted, doubts = servo.identified_servo(servo.read_move(str(tmp_path / "session")))
    assert (fitted.frequency, fitted.delay) == pytest.approx((15.0, 0.008), rel=0.03)
    assert not any(doubt.forbids for doubt in doubts)


# --- Backlash ---
POSTURES = [
    (0, -90, 120, 0, -30, 0),
    (30, -70, 110, 90, -60, 40),
    (-20, -100, 130, -60, 50, 90),
    (10, -80, 100, 45, 60, 0),
]
FORCES = (200, 500, 800, -200, -500, -800, 300, 700)


@pytest.fixture(scope="module")
def arm():
    return read_arm(find_file("test_piece.yaml"))


def pushed(arm, width, noise: float, rng, postures=POSTURES, forces=FORCES) -> play.Pushes:
    """Readings of a robot with a backlash [rad], (6,), which lies on one flank of each joint or the other."""
    robot, mount = arm
    rows = []
    for posture in np.radians(postures):
        frames, loads = forward(robot, mount, posture), link_loads(robot, mount)
        weight = load_torque(frames, np.zeros(6), loads)
        for axis in range(3):
            lever = jacobian_at(frames, frames.tool.position)[axis]
            flank = np.array([flank_after(*pair, 0.0) for pair in zip(weight, robot.friction_torque, strict=True)])
            for force in forces:
                torque = weight + lever * force
                flank = np.array([flank_after(*row) for row in zip(torque, robot.friction_torque, flank, strict=True)])
                soft = np.sum(robot.joint_compliance * lever**2)
                reading = 1e-4 + soft * force + 0.5 * lever @ (width * flank) + noise * rng.standard_normal()
                rows.append((*posture, axis, force, reading))
    rows = np.array(rows)
    sigma = np.full(len(rows), noise)
    return play.Pushes(rows[:, :6], rows[:, 6].astype(int), rows[:, 7], rows[:, 8], sigma)


def test_the_backlash_of_joints_that_reverse_is_found_and_its_interval_covers_the_truth(arm):
    """Without noise to the digit; with 2 um in 95 % of 20 robots, within 4 deviations of the binomial distribution."""
    rng, hits, count = np.random.default_rng(4), 0, 0
    for k in range(21):
        width = arm[0].backlash * rng.uniform(0.5, 2.0, 6)
        fitted = play.fit_backlash(*arm, pushed(arm, width, 1e-12 if k == 0 else 2e-6, rng))
        which = np.array(fitted.joints) - 1
        if k == 0:
            assert len(which) >= 3 and fitted.width[which] == pytest.approx(width[which], rel=1e-3)
            continue
        if which.size:
            worst = np.abs(fitted.width[which] - width[which]) / fitted.width[which]
            hits, count = hits + int(np.sum(worst <= fitted.half)), count + which.size
    assert count > 20 and hits >= 0.95 * count - 4 * binom.std(count, 0.95)


def test_one_posture_gives_the_common_multiple_and_robots_are_drawn_around_it(arm, tmp_path, capsys):
    pushes = pushed(arm, 1.5 * arm[0].backlash, 1e-6, np.random.default_rng(5), POSTURES[:1])
    names = ",".join((*play.JOINTS, "axis", "force_n", "reading_mm", "sigma_um"))
    rows = zip(np.degrees(pushes.q), pushes.axis, pushes.force, MM * pushes.reading, strict=True)
    lines = [f"{','.join(f'{a:.6f}' for a in q)},{'xyz'[k]},{f},{d:.6f},1" for q, k, f, d in rows]
    (tmp_path / "pushes.csv").write_text("\n".join([names, *lines]))
    words = "identify", "backlash", str(tmp_path / "pushes.csv"), "--arm", "test_piece.yaml", "--out", str(tmp_path)
    _, _, values, _ = printed(capsys, *words)
    assert values["usable"] and values["multiple"] == pytest.approx(1.5, abs=3 * values["half_width"])
    keys = read_tree(tmp_path / "backlash.yaml")
    least, most = (keys["uncertainty"][name] for name in ("least_backlash", "backlash"))
    assert 0.0 <= least < 1.0 < most and least + most == pytest.approx(2.0, abs=1e-5)
    cell = read_cell(find_file("test_piece.yaml"), [f"uncertainty.least_backlash={least}"])
    cell = cell.replace(uncertainty=cell.uncertainty.replace(backlash=most))
    drawn = perturbed(cell, np.random.default_rng(1)).imperfections.backlash / cell.arm.backlash
    assert np.all((least <= drawn) & (drawn <= most))


@pytest.mark.parametrize(("change", "words"), [
    (lambda p: {"reading": -p.reading}, "unit or sign of force or reading"),
    (lambda p: {"reading": p.reading * 25.4}, "unit or sign of force or reading"),
    (lambda p: {"force": p.force * 1e-3}, "no load of a joint reverses"),
])  # fmt: skip
def test_another_sign_or_unit_or_too_little_force_is_named(arm, change, words):
    pushes = pushed(arm, arm[0].backlash, 1e-6, np.random.default_rng(6))
    pushes = dataclasses.replace(pushes, **change(pushes))
    try:
        assert any(
            doubt.forbids and words in doubt.text for doubt in play.fit_backlash(*arm, pushes, "made.csv").doubts
        )
    except InputError as error:
        assert words in str(error)


def test_a_table_with_push_alone_or_another_axis_is_refused(tmp_path):
    names = ",".join((*play.JOINTS, "axis", "force_n", "reading_mm"))
    for row, words in (
        ("0,-90,90,0,0,0,x,100,0.01", "needs push and pull"),
        ("0,-90,90,0,0,0,u,1,0", "axis must be x, y or z"),
    ):
        (tmp_path / "bad.csv").write_text("\n".join([names, row, row]))
        with pytest.raises(InputError, match=words):
            play.read_pushes(tmp_path / "bad.csv")
