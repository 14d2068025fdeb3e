"""RSI: a simulated controller over UDP receives the correction of its place on the path."""

import contextlib
import json
import os
import queue
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from xml.etree import ElementTree

import numpy as np
import pytest
from ros_domain import open_ports
from rsi_controller import Controller, telegram
from samples.recording_samples import full_disk
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import InputError, MessageError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import cell_text, read_cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cli import main
from kr270_milling.decide.programs.files import write_rsi_table
from kr270_milling.live.rsi import session as rsi_session
from kr270_milling.live.rsi.corrector import CorrectionTable, Corrector, read_corrections
from kr270_milling.live.rsi.session import RsiRecording, RsiSession, open_socket
from kr270_milling.live.rsi.telegram import Elements, read_elements, read_telegram, write_answer
from kr270_milling.physics.robot import pose
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.passes import series

CYCLE = 0.004
FEED = 4.0 / 60  # [m/s]
LIMIT = 60.0  # [s] for what does not happen


def table_of(position, shift) -> CorrectionTable:
    position = np.asarray(position, float)
    correction = np.zeros((len(position), 6))
    correction[:, :3] = shift
    return CorrectionTable(CYCLE * np.arange(len(position)), position, correction)


def shift_at(x) -> np.ndarray:
    return np.stack([0 * x, 1e-4 * np.sin(60 * x), -3e-5 + 0 * x], -1)


def line() -> CorrectionTable:
    x = np.arange(0.0, 0.05 + 1e-9, FEED * CYCLE)
    return table_of(np.stack([x, 0 * x, 0 * x], -1), shift_at(x))


def corrections(corrector: Corrector, points) -> np.ndarray:
    return np.array([corrector.step(p) for p in points])


def corrector_of(table: CorrectionTable) -> Corrector:
    return Corrector(table, CYCLE)


# --- the correction belongs to the place ---


RUNS = {f"{override:.0%}": np.arange(0.0, 0.05, override * FEED * CYCLE) for override in (0.1, 0.3, 1.0)}
RUNS["a stop"] = np.concatenate([np.linspace(0, 0.02, 200), np.full(500, 0.02), np.linspace(0.02, 0.04, 200)])


@pytest.mark.parametrize("x", RUNS.values(), ids=RUNS)
def test_the_correction_starts_from_nothing_and_is_that_of_the_place_whatever_override_and_stops(x):
    applied = corrections(corrector_of(line()), np.stack([x, 0 * x, 0 * x], -1))
    assert np.abs(applied[0]).max() < 1e-6
    late = (x >= 0.02) & (x < 0.049)
    np.testing.assert_allclose(applied[late, :3], shift_at(x[late]), rtol=0, atol=1e-8)


def test_a_path_that_crosses_itself_and_one_that_returns_keep_their_order():
    """The correction counts the way, so that a wrong leg shows."""
    angle = np.linspace(0.0, 2 * np.pi, 800)
    eight = np.stack([0.03 * np.sin(angle), 0.03 * np.sin(2 * angle), 0.01 * np.sin(3 * angle)], -1)
    there = np.linspace(0.0, 0.02, 300)
    back = np.concatenate([there, there[::-1][1:]])
    for points in (eight, np.stack([back, 0 * back, 0 * back], -1)):
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        table = table_of(points, np.stack([0 * way, 2e-4 * way / way[-1], 0 * way], -1))
        applied = corrections(corrector_of(table), points)
        assert np.abs(applied[100:, 1] - table.correction[100:, 1]).max() < 1e-6


# --- limits ---


def test_size_and_rate_are_limited_whatever_the_table_and_the_robot_do():
    rng = np.random.default_rng(5)
    size, angle, rate = 2e-4, 1e-3, 5e-3
    table = line()
    wild = CorrectionTable(table.time, table.position, rng.normal(0.0, 1e-2, (len(table.time), 6)))
    corrector = Corrector(wild, CYCLE, size, angle, rate)
    before = np.zeros(6)
    for point in table.position + rng.normal(0.0, 5e-4, table.position.shape):
        now = corrector.step(point, int(rng.integers(1, 6)))
        assert np.linalg.norm(now[:3]) <= size * 1.001 and np.linalg.norm(now[3:]) <= angle * 1.001
        assert np.linalg.norm(now[:3] - before[:3]) <= rate * CYCLE * 1.001
        before = now
    assert corrector.limited > 100


def test_away_from_the_path_the_correction_ramps_to_zero_and_back_and_missed_cycles_start_it_from_zero():
    table = line()
    corrector = corrector_of(table)
    corrections(corrector, table.position[:100])
    lifted = corrections(corrector, np.repeat(table.position[100:101] + [0, 0, 5e-3], 60, axis=0))
    assert np.all(lifted[-1] == 0.0) and corrector.reason == "5.0 mm from the path"
    assert np.abs(np.diff(lifted, axis=0)).max() < 1e-5
    corrections(corrector, table.position[100:175])
    np.testing.assert_allclose(corrector.applied, table.correction[174], atol=1e-8)
    corrector.step(table.position[180], 6)
    assert corrector.share == 0.0 and corrector.reason == "5 cycles without a telegram"


# --- telegrams ---


def test_a_telegram_is_read_in_si_and_the_answer_repeats_its_counter():
    read = read_telegram(telegram(17, (1.5, -2.0, 3.0), abc=(180.0, 0.0, -90.0), delay=2))
    np.testing.assert_allclose(read.commanded, [1.5e-3, -2e-3, 3e-3, np.pi, 0.0, -np.pi / 2])
    assert (read.ipoc, read.delay) == (17, 2)
    answer = write_answer(17, np.array([1e-4, 0.0, -2.5e-6, np.radians(0.01), 0.0, 0.0])).decode()
    wanted = 'X="0.1000" Y="0.0000" Z="-0.0025" A="0.0100" B="0.0000" C="0.0000"'
    assert answer == f'<Sen Type="ImFree"><RKorr {wanted}/><IPOC>17</IPOC></Sen>'


GOOD = telegram(1, (0, 0, 0))
BAD = [
    b"", b"hello", GOOD[:60], b"<Sen/>", GOOD.replace(b"<IPOC>1</IPOC>", b""), telegram("9" * 400, (0, 0, 0)),
    telegram(-4, (0, 0, 0)), GOOD.replace(b'X="0.0000"', b'X="zero"'), telegram(1, (float("nan"), 0, 0)),
    telegram(1, (1e9, 0, 0)), b'<!DOCTYPE Rob [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><Rob><IPOC>&b;</IPOC></Rob>',
    ('<?xml version="1.0" encoding="UTF-16"?>' + GOOD.decode()).encode("utf-16"), GOOD + b" " * 5000, bytes(range(256)),
]  # fmt: skip


def test_an_unusable_telegram_is_refused_in_one_sentence():
    for data in BAD:
        with pytest.raises(MessageError) as caught:
            read_telegram(data)
        assert "\n" not in str(caught.value)


# --- over UDP ---


@pytest.fixture
def patient(monkeypatch):
    """On a busy machine a controller may be silent for long."""
    monkeypatch.setattr(rsi_session, "SILENCE", LIMIT)


@pytest.fixture
def running(patient):
    """A session over the line, its controller, and its sentences."""
    table, sentences = line(), []
    connection = open_socket("127.0.0.1", 0)
    session = RsiSession(connection, corrector_of(table), 4, sentences.append)
    thread = threading.Thread(target=session.run)
    thread.start()
    controller = Controller(connection.getsockname()[1])
    yield table, session, controller, sentences
    session.stop.set()
    thread.join()
    controller.close()
    connection.close()


def test_lost_repeated_foreign_and_wrong_telegrams_do_not_disturb_the_correction(running):
    table, session, controller, sentences = running
    other = Controller(controller.port)
    points = 1e3 * table.position
    for k in range(150):
        applied = controller.cycle(points[k])
    controller.ipoc += 8  # two cycles are lost
    applied = controller.cycle(points[152])
    np.testing.assert_allclose(1e-3 * applied[:3], table.correction[152, :3], atol=1e-6)
    controller.send(telegram(controller.ipoc, points[152]))  # repeated
    assert np.array_equal(controller.receive()[1], applied)
    for data in BAD:
        controller.send(data)
    controller.send(telegram(controller.ipoc - 400, points[30]))  # an old counter
    other.send(telegram(controller.ipoc + 4, (500.0, 0.0, 0.0)))
    assert not other.has_answer() and not controller.has_answer()
    np.testing.assert_allclose(1e-3 * controller.cycle(points[153])[:3], table.correction[153, :3], atol=1e-6)
    assert (session.repeated, session.missed, session.refused) == (1, 2, len(BAD) + 2)
    assert any(s.startswith("ignored: ") for s in sentences) and "on the path, 0.0 mm of the path" in sentences
    other.close()


def test_the_counter_of_the_robot_may_wrap(running):
    table, session, controller, _ = running
    controller.ipoc = 2**32 - 200
    applied = np.array([controller.cycle(point) for point in 1e3 * table.position[:150]])
    np.testing.assert_allclose(1e-3 * applied[60:, :3], table.correction[60:150, :3], rtol=0, atol=1e-6)
    assert (session.missed, session.refused) == (0, 0)


def test_after_a_stop_of_this_host_the_newest_telegram_is_answered_and_the_others_are_missed(running):
    """49 of 50 cycles; the time that a telegram waited counts to its answer. The session records after it counts."""
    _, session, controller, _ = running
    recorded, free = queue.Queue(), threading.Event()
    session.record = lambda *cycle: recorded.put(cycle) or free.wait(LIMIT)
    controller.cycle((0.0, 0.0, 0.0))
    recorded.get(timeout=LIMIT)
    for _ in range(50):
        controller.ipoc += 4
        controller.send(telegram(controller.ipoc, (0.0, 0.0, 0.0)))
    time.sleep(0.1)
    free.set()
    assert controller.receive()[0] == controller.ipoc and not controller.has_answer()
    recorded.get(timeout=LIMIT)
    assert (session.answered, session.missed, session.late) == (2, 49, session.late) and session.late >= 1
    assert session.longest >= 0.1


def test_a_session_runs_with_priority_or_says_why_not():
    before = os.sched_getscheduler(0)
    with rsi_session.real_time() as refused:
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == (not refused)
        assert not refused or "SCHED_FIFO: " in refused
    assert os.sched_getscheduler(0) == before


def test_a_robot_that_falls_silent_ends_the_session(running, monkeypatch):
    _, session, controller, sentences = running
    monkeypatch.setattr(rsi_session, "SILENCE", 0.1)
    controller.cycle((0.0, 0.0, 0.0))
    assert session.stop.wait(LIMIT)
    assert sentences[-1] == "no telegram for 0.1 s"


def test_a_full_disk_is_reported_and_the_answers_continue(running, tmp_path):
    table, session, controller, sentences = running
    recording = RsiRecording(tmp_path / "rsi", table, {}, {}, time.time_ns)
    session.record = recording.add
    end = time.monotonic() + LIMIT
    with full_disk(next((tmp_path / "rsi").glob("*.mcap")).stat().st_size + 100):
        while not session.recording_failed and time.monotonic() < end:
            controller.cycle((0.0, 0.0, 0.0))
        controller.cycle((0.0, 0.0, 0.0))
        recording.note("is not recorded, and raises no error")
    assert any(s.startswith("answers continue without a recording: ") and "are safe" in s for s in sentences)


def test_the_command_answers_a_controller_and_its_recording_is_reported(tmp_path, capsys, patient):
    """At 50 % override; the robot follows the correction, and its arm is commanded 0.5 mm lower because of its sag."""
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=20", "stock.grid_step_um=50"])
    (tmp_path / "cell.yaml").write_text(cell_text(cell))
    target = path_of(cell).target
    programmed = target.with_position(target.position - [0.0, 0.0, 5e-4])
    shift = np.array([0.0, 6e-5, 0.0])
    corrected = programmed.with_position(programmed.position + shift)
    write_rsi_table(tmp_path / "rsi_offsets_linear.csv", programmed, corrected)
    points = 1e3 * programmed.sample(np.arange(0, target.duration_ns + 1, 2_000_000))
    with open_socket("127.0.0.1", 0) as connection:
        port = connection.getsockname()[1]

    def robot() -> None:
        """Run the path when the command listens, then end the command."""
        end, applied = time.monotonic() + LIMIT, np.zeros(6)
        while port not in open_ports() and time.monotonic() < end:
            time.sleep(0.01)
        with contextlib.closing(Controller(port)) as controller:
            for k, point in enumerate(points):
                applied = controller.cycle(point, actual_mm=point + applied[:3])
                assert k < 10 or np.abs(1e-3 * applied[:3] - shift).max() < 1e-6
        os.kill(os.getpid(), signal.SIGHUP)  # its terminal closes

    with ThreadPoolExecutor(1) as thread:
        moving = thread.submit(robot)
        words = [str(tmp_path), "--port", str(port), "--ramp-s", "0.01", "--cell", str(tmp_path / "cell.yaml")]
        assert main(["rsi", *words, "--out", str(tmp_path / "rsi"), "--json"]) == 128 + signal.SIGHUP
        moving.result()
    answer = json.loads(capsys.readouterr().out)
    assert (answer["answered"], answer["path_share"]) == (len(points), 1.0)
    with Recording(tmp_path / "rsi") as recording:
        stamp, values, _ = series(recording, "/correction")
        np.testing.assert_array_equal(stamp, 4_000_000 * np.arange(len(points)))
        np.testing.assert_allclose(values[10:, :3], np.tile(shift, (len(points) - 10, 1)), atol=1e-6)
        assert recording.topics()["/tool_pose"].count == len(stamp)
    assert main(["report", str(tmp_path / "rsi"), "--out", str(tmp_path / "report"), "--json"]) == 0
    (ran,) = json.loads(capsys.readouterr().out)["passes"]
    assert (ran["stamps"], ran["complete"], ran["messages_lost"]) == ("place", True, 0)
    assert abs(ran["static_deviation_um"] - 60.0) < 0.1  # the poses of the robot do not show the deflection
    assert "RSI: poses by their place, without the deflection" in (tmp_path / "report" / "report.html").read_text()
    assert main(["compare", str(tmp_path / "rsi"), str(tmp_path / "cell.yaml"), "--json"]) == 0
    (channel,) = json.loads(capsys.readouterr().out)["channels"]
    assert channel["name"] == "deviation"


def test_a_table_without_places_and_a_used_port_are_refused(tmp_path):
    (tmp_path / "rsi.csv").write_text("time_s,dX_mm,dY_mm,dZ_mm,dA_deg,dB_deg,dC_deg\n0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n")
    with pytest.raises(InputError, match="has no column X_mm"):
        read_corrections(tmp_path / "rsi.csv")
    with open_socket("127.0.0.1", 0) as connection, pytest.raises(InputError, match="cannot be used"):
        open_socket("127.0.0.1", connection.getsockname()[1])


# --- contexts and simulators of others ---
JOINTS = tuple(f"A{k}" for k in range(1, 7))


def context(path, send: list[str], receive: list[str], sensor: str = "ImFree"):
    def rows(tags):
        return "".join(f'<ELEMENT TAG="{tag}" TYPE="DOUBLE" INDX="1" />' for tag in tags)

    path.write_text(
        f"<ROOT><CONFIG><SENTYPE>{sensor}</SENTYPE></CONFIG><SEND><ELEMENTS>{rows(send)}</ELEMENTS></SEND>"
        f"<RECEIVE><ELEMENTS>{rows(receive)}</ELEMENTS></RECEIVE></ROOT>"
    )
    return path


def axes(name: str, letters) -> list[str]:
    return [f"{name}.{letter}" for letter in letters]


#: SEND, RECEIVE -> elements; the second is that of fzi-forschungszentrum-informatik/kuka_rsi_driver
CONTEXTS = [
    (["DEF_RIst", "DEF_RSol"], axes("RKorr", "XYZABC"), {}),
    (["DEF_RIst", "DEF_RSol", "DEF_AIPos", "DEF_ASPos", "DEF_Delay", "OvPro.R"], axes("AK", JOINTS),
     dict(joints="ASPos", correction="AK", axes=JOINTS)),
    (["DEF_RIst", "DEF_AIPos"], axes("AK", JOINTS), dict(commanded="", joints="AIPos", correction="AK", axes=JOINTS)),
    (axes("Place", "XYZABC"), ["Stop", *axes("Shift", "XYZ")],
     dict(actual="Place", commanded="", correction="Shift", axes=("X", "Y", "Z"))),
    (["DEF_AIPos"], [*axes("AK", JOINTS), *axes("RKorr", "XYZABC")], dict(actual="", commanded="", joints="AIPos")),
]  # fmt: skip


@pytest.mark.parametrize(("send", "receive", "names"), CONTEXTS)
def test_the_elements_have_the_names_of_the_context(tmp_path, send, receive, names):
    elements = read_elements(context(tmp_path / "e.xml", send, receive, "Other"))
    assert elements == Elements(**{"sensor": "Other"} | names)
    answer = ElementTree.fromstring(write_answer(17, np.arange(6.0) * 1e-3, elements))
    factor = np.degrees(1.0) if elements.of_joints else 1e3
    assert answer.get("Type") == "Other" and answer.findtext("IPOC") == "17"
    assert float(answer.find(elements.correction).get(elements.axes[2])) == pytest.approx(2e-3 * factor, abs=1e-4)
    assert tuple(answer.find(elements.correction).attrib) == elements.axes


@pytest.mark.parametrize(("send", "receive", "reason"), [
    (["DEF_RIst"], ["RKorr.X", "RKorr.Y"], "RECEIVE has no element"),
    (["DEF_Delay"], axes("RKorr", "XYZ"), "SEND has no element with the pose"),
    (["DEF_RIst"], axes("AK", JOINTS), "SEND has no element with the joint positions"),
    (["DEF_RIst"], axes("P", "XYZ") + axes("Q", "XYZ"), "several elements for a correction: P, Q"),
])  # fmt: skip
def test_a_context_without_a_correction_or_a_place_is_refused(tmp_path, send, receive, reason):
    with pytest.raises(InputError, match=reason):
        read_elements(context(tmp_path / "e.xml", send, receive))
    (tmp_path / "e.xml").write_text("DEF x( )")
    with pytest.raises(InputError, match="is no XML file"):
        read_elements(tmp_path / "e.xml")


def test_a_correction_of_joints_moves_the_tool_by_the_correction():
    cell = read_cell(find_file("paper.yaml"))
    arm = arm_of(cell)
    session = RsiSession(None, corrector_of(line()), 4, print, elements=Elements(axes=JOINTS, joints="AIPos"), arm=arm)
    correction = np.array([3e-4, -5e-4, 2e-4, 1e-4, -2e-4, 3e-4])
    q = arm.joints_at(path_of(cell).target.position[:1], path_of(cell).target.quaternion[:1])[0]
    before, after = (
        arm.place.inverse() @ pose(arm.arm, arm.mount, joints)
        for joints in (q, q + session._joint_correction(q, correction))
    )
    np.testing.assert_allclose(after.position - before.position, correction[:3], atol=1e-6)
    turn = Rotation.from_matrix(after.rotation @ before.rotation.T).as_euler("ZYX")
    np.testing.assert_allclose(turn, correction[3:], atol=1e-6)


def fzi(ipoc: int, joints) -> bytes:
    """A telegram of FZI's simulator with the context of its driver."""
    pose = dict.fromkeys("XYZABC", "0.0")
    rest = {"GearTorque": dict.fromkeys(JOINTS, "0.0"), "ProgStatus": {"R": "3"}, "OvPro": {"R": "100.0"}}
    elements = {"RIst": pose, "RSol": pose, "AIPos": joints, "ASPos": dict.fromkeys(JOINTS, "0.0"), "Delay": {"D": "0"}}
    root = ElementTree.Element("Rob", {"TYPE": "KukaRsiDriver"})
    for name, values in (elements | rest).items():
        ElementTree.SubElement(root, name, values)
    ElementTree.SubElement(root, "IPOC").text = str(ipoc)
    return ElementTree.tostring(root)


def kroshu(ipoc: int, joints) -> bytes:
    """A telegram of kroshu's kuka_rsi_simulator."""
    root = ElementTree.Element("Rob", {"TYPE": "KUKA"})
    outer = {f"E{k}": "0.0" for k in range(1, 7)}
    elements = {"RIst": dict.fromkeys("XYZABC", "0.0"), "AIPos": joints, "EIPos": outer, "Delay": {"D": "0"}}
    for name, values in elements.items():
        ElementTree.SubElement(root, name, values)
    ElementTree.SubElement(root, "IPOC").text = str(ipoc)
    return ElementTree.tostring(root, encoding="utf-8", method="xml").replace(b" />", b"/>")


@pytest.mark.parametrize(("simulator", "case"), [(fzi, 1), (kroshu, 2)])
def test_the_telegrams_of_the_public_simulators_are_answered(tmp_path, patient, monkeypatch, simulator, case):
    """Their counters rise by one a cycle, and they take AK as joint positions or add it to the first posture.

    A rehearsal answers one telegram, which is in no count of the session.
    """
    rehearsed = []
    monkeypatch.setattr(rsi_session, "write_answer", lambda *answer: rehearsed.append(answer) or write_answer(*answer))
    send, receive, _ = CONTEXTS[case]
    elements = read_elements(context(tmp_path / "e.xml", send, receive))
    with open_socket("127.0.0.1", 0) as connection:
        arm = arm_of(read_cell(find_file("paper.yaml")))
        session = RsiSession(connection, corrector_of(line()), 4, lambda _: None, elements=elements, arm=arm)
        session.rehearse()
        assert len(rehearsed) == 1
        with ThreadPoolExecutor(1) as thread, contextlib.closing(Controller(connection.getsockname()[1])) as robot:
            done = thread.submit(session.run)
            joints = dict(zip(JOINTS, ("0", "-90.0", "90.0", "0.0", "90.0", "0.0"), strict=True))
            for ipoc in range(1, 301):
                robot.send(simulator(ipoc, joints))
                answer = ElementTree.fromstring(robot.socket.recv(1024))
                assert answer.tag == "Sen" and answer.findtext("IPOC") == str(ipoc)
                assert all(abs(float(answer.find("AK").get(joint))) < 0.5 for joint in JOINTS)
            session.stop.set()
            done.result()
    assert (session.answered, session.refused, session.missed, session.repeated) == (300, 0, 0, 0)
