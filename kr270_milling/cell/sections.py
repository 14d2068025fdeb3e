"""Sections of the parameter file that describe the job: where and what to cut, limits, tolerances, robot programs."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import math
import os
import pathlib
import re
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import Record, derived, parameter, specs
from kr270_milling.path.cam.readers import READERS, PathReader, known_reader, read_path_file
from kr270_milling.path.kinematics import NO_ROTARY_AXES, Kinematics
from kr270_milling.path.source_program import SourceProgram
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.physics.motion.imperfections import LEAST_SERVO_FREQUENCY

READERS[".mcap"] = PathReader("kr270_milling.recordings.bag.recorded_path", "read_recorded", ("topic", "feed"))


@dataclass(frozen=True, eq=False)
class Workpiece(Record):
    """YAML ``workpiece``: where the part is clamped."""

    xyz: np.ndarray = parameter(
        [],
        unit="mm",
        low=-1e5,
        high=1e5,
        text="origin of the workpiece frame on base_link, three numbers; or base_kuka: BASE_DATA",
    )
    abc: np.ndarray = parameter(
        [], unit="deg", low=-360.0, high=360.0, text="orientation of the workpiece frame, KUKA A, B, C, three numbers"
    )
    at_start_joints: bool = parameter(
        False, text="place it so that start_joints_deg put the tool where the straight cut starts; xyz, abc follow"
    )
    fixtures: np.ndarray = parameter(
        [],
        unit="mm",
        low=-1e5,
        high=1e5,
        text="boxes that the tool must not enter, workpiece frame: x, y, z of both corners, one box after the other",
    )

    table_z: float = parameter(
        math.nan,
        unit="mm",
        low=-1e5,
        high=1e5,
        text="height of the table, which the tool must not enter, workpiece frame; not given: the bottom of the stock",
    )

    def check(self) -> None:
        for key, value in (("xyz_mm", 1e3 * self.xyz), ("abc_deg", np.degrees(self.abc))):
            if value.size != 3 and (value.size or not self.at_start_joints):
                allowed = "three numbers (or, for a straight cut, give at_start_joints: true instead)"
                raise ParameterError(key, value.tolist() or None, allowed)
        if self.fixtures.size % 6:
            raise ParameterError("fixtures_mm", (1e3 * self.fixtures).tolist(), "six numbers for each box")

    @property
    def fixture_boxes(self) -> np.ndarray:
        """Lower and upper corner of each box [m], (n, 2, 3), workpiece frame."""
        return np.sort(self.fixtures.reshape(-1, 2, 3), axis=1)

    @property
    def pose(self) -> Pose:
        """workpiece -> base_link."""
        return Pose.from_abc(self.xyz, self.abc)


@dataclass(frozen=True, eq=False)
class PathSection(Record):
    """YAML ``path``: a tool path file, or a straight cut along +x of the workpiece frame."""

    file: str = parameter(
        "", text="G-code, Heidenhain, APT/CL, KRL, CSV of points or a recording, workpiece frame; empty: a straight cut"
    )
    topic: str = parameter("", text="topic of the path in a recording that has several")
    tool: str = parameter("", text="tool of a program with several tools whose moves are run, as T1")
    offsets: np.ndarray = parameter(
        [],
        unit="mm",
        low=-1e5,
        high=1e5,
        text="places of the work offsets G54, G55 ... G59.3 of a G-code program, workpiece frame: x, y, z of each",
    )
    start: np.ndarray = parameter(
        [0.0, 0.0], unit="mm", size=2, low=-1e5, high=1e5, text="straight cut: x, y of the tool tip at the start"
    )
    depth_of_cut: float = parameter(0.0, unit="mm", low=0.0, high=100.0, text="straight cut: a_p below the stock's top")
    length: float = parameter(0.0, unit="mm", low=0.0, high=10000.0, text="straight cut: its length")
    feed_rate: float = parameter(
        0.0,
        unit="m_per_min",
        low=0.0,
        high=60.0,
        text="feed rate v_f of a straight cut, a program without F, or a recorded path whose poses have one stamp",
    )

    radial_immersion: float = parameter(
        1.0, above=0.0, high=1.0, text="lobes over speed: width of the cut, a share of the diameter"
    )
    mode: str = parameter(
        "slot", choices=("slot", "up", "down"), text="lobes over speed: sense of a cut that is no slot"
    )

    content: Toolpath | TimedPath | None = derived(None)  #: content of ``file``, once it is read
    machine: Kinematics = derived(NO_ROTARY_AXES)  #: section ``machine`` of the cell

    @property
    def recorded(self) -> bool:
        """Return whether ``file`` is a recording."""
        reader = known_reader(self.file)
        return reader is not None and reader.recorded

    @property
    def file_name(self) -> str:
        return self.file.rpartition("/")[2]

    @property
    def name(self) -> str:
        return self.file_name or f"straight cut of {1e3 * self.length:g} mm"

    @property
    def files(self) -> tuple[pathlib.Path, ...]:
        """Absolute paths of the files that a copy of the cell needs, since nodes run in another directory."""
        files = (self.file, *self.source.files) if self.file else ()
        return tuple(pathlib.Path(file).resolve() for file in files)

    @property
    def sha256(self) -> str:
        """Hash of the file, and of those that it calls; empty for a straight cut."""
        digest = hashlib.sha256()
        for file in self.files:
            with open(file, "rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest() if self.file else ""

    @property
    def source(self) -> SourceProgram:
        """Statements of the program beside its moves; empty for a straight cut and a recording."""
        read = self.read() if self.file else None
        return read.program if isinstance(read, Toolpath) else SourceProgram()

    @property
    def cutting_time(self) -> float:
        """Time of the cutting moves at their programmed feeds [s]; of a recording: its duration; 0: no program."""
        if not self.file:
            return 0.0
        read = self.read()
        if isinstance(read, TimedPath):
            return read.trajectory.duration_ns * 1e-9
        cutting = ~read.rapid & (read.feed > 0.0)  # a recorded path may begin with a block without a feed
        return float(np.sum(read.block_length[cutting] / read.feed[cutting]))

    @property
    def tilt(self) -> float:
        """Return the largest angle between the tool and z of the workpiece in a cutting move [rad]; 0: no program."""
        if not self.file:
            return 0.0
        read = self.read()
        return (read.toolpath if isinstance(read, TimedPath) else read).cutting_tilt

    @property
    def feeds(self) -> tuple[float, float, float]:
        """Highest and slow feed of the milling moves [m/s], and the length of the path [m]; 0: not known.

        A program that only drills has the highest feed of all its feed moves. The slow feed is not exceeded in a tenth
        of the time of the milling moves in the xy plane.
        """
        if not self.file:
            return self.feed_rate, self.feed_rate, self.length
        try:
            read = self.read()
        except InputError:
            return 0.0, 0.0, 0.0
        path = read.toolpath if isinstance(read, TimedPath) else read
        milling = ~path.rapid & ~path.drilling
        highest = float(np.max(path.feed[milling if milling.any() else ~path.rapid], initial=0.0))
        milling = np.flatnonzero(milling & (path.plane_length > 0.0) & (path.feed > 0.0))
        if not milling.size:
            return highest, 0.0, path.length
        milling = milling[np.argsort(path.feed[milling], kind="stable")]
        time = np.cumsum(path.block_length[milling] / path.feed[milling])
        slow = 0.1  # share of the time of the milling moves
        return highest, float(path.feed[milling[np.searchsorted(time, slow * time[-1])]]), path.length

    def read(self) -> Toolpath | TimedPath:
        """Return the content of ``file``; raises InputError where it cannot be read or has another feed than the cell.

        A section with its content keeps it, also when the file changes later.
        """
        if self.content is not None:
            return self.content
        try:
            state = os.stat(self.file)
        except (OSError, ValueError) as error:
            raise InputError(self.file, f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
        offsets = tuple(self.offsets.tolist())
        stamp = state.st_mtime_ns, state.st_size
        read = _read_once(self.file, self.tool, self.topic, self.feed_rate, offsets, self.machine, stamp)
        if not (self.length or self.recorded or isinstance(read, TimedPath)):  # else: the feed of the straight cut
            _check_feed(self.file, read, self.feed_rate)
        return read

    def loaded(self) -> PathSection:
        """Return the section with the content of its file; unchanged where the file cannot be read."""
        if not self.file or self.content is not None:
            return self
        with contextlib.suppress(InputError):
            return self.replace(content=self.read())
        return self

    def replace(self, **changes) -> PathSection:
        """Return a copy with some values (SI) replaced; its file is read anew."""
        return super().replace(**{"content": None, **changes})

    def check(self) -> None:
        if self.topic and not self.recorded:
            raise ParameterError("topic", self.topic, "empty where path.file is no recording (.mcap)")
        if self.offsets.size % 3 or self.offsets.size > 27:
            raise ParameterError("offsets_mm", (1e3 * self.offsets).tolist(), "three numbers each for G54 to G59.3")
        for spec in () if self.file else specs(PathSection):
            if spec.kind is float and not getattr(self, spec.name) > 0.0:
                value = getattr(self, spec.name) / spec.scale
                raise ParameterError(spec.key, value, "above 0 for a straight cut (or give path.file)")


def _check_feed(file: str, path: Toolpath, feed: float) -> None:
    """Raise InputError where the feeds of the program differ from the feed of the cell [m/s]; 0: the cell has none."""
    same_feed = 1e-6  # [m/s]
    other = ~path.rapid & (np.abs(path.feed - feed) > same_feed)
    if feed and other.any():
        block = int(np.argmax(other))
        reason = (
            f"its feed is {6e4 * path.feed[block]:.6g} mm/min, but path.feed_rate_m_per_min of the cell says "
            f"{6e4 * feed:.6g}; leave that key out"
        )
        raise InputError(file, reason, int(path.line[block]))


@functools.lru_cache(maxsize=8)
def _read_once(
    file: str, tool: str, topic: str, feed: float, offsets: tuple, machine: Kinematics, stamp: tuple
) -> Toolpath | TimedPath:
    """Return the tool path of a file, read once for each tool as long as its stamp is the same."""
    return read_path_file(file, tool, topic, feed, offsets, machine)


@dataclass(frozen=True, eq=False)
class Limits(Record):
    """YAML ``limits``: beyond these limits a path must not run, or gets a warning.

    wrist_angle: A4 and A6 turn 1 / sin(A5) times as fast as the tool, 19 times at 3 deg, and the least correction
    across the wrist makes them swing. elbow_angle: the nearly stretched arm turns A3 by 11 times what its reach asks
    for at 5 deg. shoulder_distance: at 0.1 m a feed of 4 m/min turns A1 by 38 deg/s.
    """

    wrist_angle: float = parameter(math.radians(3.0), unit="deg", low=0.0, high=90.0, text="least size of A5")
    elbow_angle: float = parameter(
        math.radians(5.0), unit="deg", low=0.0, high=90.0, text="least angle between upper arm and forearm"
    )
    shoulder_distance: float = parameter(
        0.1, unit="mm", low=0.0, high=5000.0, text="least distance of the wrist centre from axis 1"
    )
    blending_share: float = parameter(
        0.5, above=0.0, high=10.0, text="share of the correction that the blending of LIN motions may round off"
    )
    # 0.5 mm: nodes of the height map of a tool of 50 mm; deeper, a tooth takes chips that break it at the rapid feed
    rapid_contact: float = parameter(
        20e-6,
        unit="um",
        low=0.0,
        high=500.0,
        text="deepest and widest contact of a programmed rapid move with material",
    )
    below_stock: float = parameter(
        0.0, unit="mm", low=0.0, high=1e3, text="how far the tool may go below the stock, into a sacrificial plate"
    )
    # assumed: radius of a sharp edge for aluminium, 5 to 10 um; it ploughs where chips are thinner
    least_chip: float = parameter(10e-6, unit="um", low=0.0, high=1e3, text="compensation.feed: least feed per tooth")
    cutting_force: float = parameter(
        0.0, unit="n", low=0.0, high=1e5, text="compensation.feed: largest mean force of a period; 0: not limited"
    )
    # assumed: a milling spindle of the size that a heavy arm carries; 60,000 rpm: no milling spindle is expected above
    spindle_torque: float = parameter(10.0, unit="n_m", above=0.0, high=1e4, text="most that the spindle gives")
    spindle_power: float = parameter(10e3, unit="kw", above=0.0, high=1e3, text="most that the spindle gives")
    spindle_speed: float = parameter(
        2000.0 * math.pi, unit="rpm", above=0.0, high=2e5, text="highest speed that the spindle runs"
    )


@dataclass(frozen=True, eq=False)
class Tolerances(Record):
    """Tolerances [m]: half widths of the band about the nominal surface; 0: none is asked for.

    A feature takes its own tolerance, else that of walls or floors, else ``tolerance``.
    """

    tolerance: float = parameter(
        0.0, unit="um", low=0.0, high=1e5, text="largest allowed error of walls and floors; 0: no tolerance"
    )
    wall_tolerance: float = parameter(
        0.0, unit="um", low=0.0, high=1e5, text="largest allowed error of walls; 0: that of the part"
    )
    floor_tolerance: float = parameter(
        0.0, unit="um", low=0.0, high=1e5, text="largest allowed error of floors; 0: that of the part"
    )
    features: tuple[str, ...] = parameter((), text="tolerances of single features in um, as name=30")

    def check(self) -> None:
        for text in self.features:
            _feature(text)

    def of(self, feature: str | None = None) -> tuple[float, float]:
        """Tolerance of the walls and of the floors [m] of a feature, or of the whole part; 0: none is asked for."""
        own = dict(map(_feature, self.features))
        if feature in own:
            return own[feature], own[feature]
        return self.wall_tolerance or self.tolerance, self.floor_tolerance or self.tolerance


def _feature(text: str) -> tuple[str, float]:
    name, equals, number = text.rpartition("=")
    try:
        value = float(number) * 1e-6
    except ValueError:
        value = -1.0
    if not (equals and name and 0.0 < value < 0.1):
        raise ParameterError("features", text, "the name of a feature, =, and its tolerance in um")
    return name, value


@dataclass(frozen=True, eq=False)
class Program(Record):
    """Names, motions and the machine's own commands of the robot programs."""

    name: str = parameter("MILLING", text="module name, to which _ORG_001 and the like are added")
    motion: str = parameter("SPLINE", choices=("SPLINE", "LIN"), text="SPL segments in SPLINE blocks, or LIN and CIRC")
    line_limit: int = parameter(1400, low=100, high=100000, text="most lines of a .src or .dat file")
    # assumed: a KR C4 has about 4 MB for programs, of which other programs take their share
    memory: float = parameter(
        4e6, unit="mb", low=0.01, high=1000.0, text="most bytes of a program; a larger one is written in parts"
    )
    blend_distance: float = parameter(1e-3, unit="mm", low=0.0, high=100.0, text="$APO.CDIS of LIN motions")
    tolerance: float = parameter(
        2e-6,
        unit="um",
        low=0.0,
        high=1000.0,
        text="how far the motion through the points may leave the planned path; 0: a point at each controller step",
    )
    point_spacing: float = parameter(1e-6, unit="mm", above=0.0, high=10.0, text="closer points are left out")
    approach_speed_percent: int = parameter(10, low=1, high=100, text="axis speed of the PTP motions")
    approach_feed: float = parameter(0.05, unit="m_per_min", above=0.0, high=60.0, text="down to the first point")
    safe_height: float = parameter(
        0.05, unit="mm", low=0.0, high=2000.0, text="height of approach and retract above the stock's top"
    )
    home: str = parameter("XHOME", text="axis position before and after: that of $CONFIG.DAT, or home_deg")
    home_angles: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="axis position that is declared as ``home``; empty: not declared"
    )
    spindle_on: tuple[str, ...] = parameter(
        (), text="KRL lines, for example $OUT[1]=TRUE; HALT or empty: it halts until the operator starts the spindle"
    )
    spindle_off: tuple[str, ...] = parameter((), text="KRL lines")
    coolant_on: tuple[str, ...] = parameter((), text="KRL lines")
    coolant_off: tuple[str, ...] = parameter((), text="KRL lines")
    spindle_run_up: float = parameter(3.0, unit="s", low=0.0, high=600.0, text="dwell after the spindle is started")
    tool_number: int = parameter(0, low=0, high=64, text="$TOOL=TOOL_DATA[n]; 0: by value")
    base_number: int = parameter(0, low=0, high=64, text="$BASE=BASE_DATA[n]; 0: by value")
    set_load: bool = parameter(False, text="whether the program sets $LOAD, or a comment says what to set")
    time_law: str = parameter(
        "jerk",
        choices=("jerk", "acceleration", "none"),
        text="statements of timing in the program: $ACC.CP and $JERK.CP (of SPLINE, KSS 8.3), $ACC.CP alone, or none",
    )
    # assumed: public programs for KUKA arms set 90 to 400 deg/s and 100 to 1000 deg/s2
    turn_speed: float = parameter(
        math.radians(200.0), unit="deg_per_s", above=0.0, high=1000.0, text="$VEL.ORI1 and $VEL.ORI2"
    )
    turn_acceleration: float = parameter(
        math.radians(200.0), unit="deg_per_s2", above=0.0, high=10000.0, text="$ACC.ORI1 and $ACC.ORI2"
    )

    def check(self) -> None:
        if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", self.name):  # with _ORG_001 the 24 characters of a KRL name
            raise ParameterError("name", self.name, "1 to 16 characters of A-Z, 0-9 and _, the first a letter")
        if not re.fullmatch(r"[A-Z$][A-Z0-9_$]{0,23}", self.home):
            raise ParameterError("home", self.home, "the name of an axis position, A-Z, 0-9, _ and $")
        if self.home_angles.size not in (0, 6):
            raise ParameterError("home_angles_deg", np.degrees(self.home_angles).tolist(), "empty or six angles")
        for key in ("spindle_on", "spindle_off", "coolant_on", "coolant_off"):
            for line in getattr(self, key):
                if not re.fullmatch(r"[ -~]{1,200}", line):
                    raise ParameterError(key, line, "lines of 1 to 200 printable ASCII characters")


@dataclass(frozen=True, eq=False)
class Uncertainty(Record):
    """YAML ``uncertainty``: relative standard deviations (of log-normal factors) and a standard deviation in mm.

    Joint compliances of one type differ by 7 to 20 % from robot to robot, and the springs of joints 1 to 3 of a KR 300
    R2500 (JonasWeigand/Robot_Identification: 0.218, 0.133, 0.244 urad/(N m)) by 6 to 16 % from Table 1 of the paper.
    The four published K_tc of aluminium 7075 scatter by 33 % (``materials.csv``). The other defaults are assumed: modal
    damping scatters by a third from mode to mode, frequencies by a tenth; a part is touched off within a few hundredths
    of a millimetre. Repeatability, noise, backlash, wear, the joining of points, and the compliances of a base or a
    tool that the cell takes as rigid are drawn evenly from 0 to the value here; ``end_share`` evenly within its range.
    """

    joint_compliance: float = parameter(
        0.15, low=0.0, high=1.0, text="relative standard deviation of each joint's compliance"
    )
    force_coefficient: float = parameter(
        0.3, low=0.0, high=1.0, text="relative standard deviation of each coefficient of the force law"
    )
    joint_compliances: np.ndarray = parameter(
        [],
        low=0.0,
        high=1.0,
        text="relative standard deviation by joint, as identified; empty: joint_compliance for all",
    )
    force_coefficients: np.ndarray = parameter(
        [],
        low=0.0,
        high=1.0,
        text="relative standard deviation by coefficient of the law; missing ones, axial or all: force_coefficient",
    )
    # assumed: a worn edge doubles the edge forces, which are half of a light cut, before it is changed
    tool_wear: float = parameter(
        0.3,
        low=0.0,
        high=10.0,
        text="largest growth of the forces by wear: a plant has 1 to 1 + this times all of them",
    )
    # the tilt of a foundation that a campaign outside of this package assumed; assumed for every floor
    base_compliance: float = parameter(
        0.08e-6,
        unit="urad_per_n_m",
        low=0.0,
        high=1e4,
        text="largest compliance of a plant's base about x and y, where arm.base_compliance is rigid there",
    )
    # assumed: a tool longer than 4 diameters has its stick-out in the cell
    tool_stick_out: float = parameter(
        4.0, low=0.0, high=20.0, text="longest stick-out of a plant's tool in diameters, where the cell's tool is rigid"
    )
    # nothing is published: from an end that touches nowhere to one that touches over its whole radius
    end_share: np.ndarray = parameter(
        [0.0, 1.0], low=0.0, high=1.0, text="lowest and highest cutting.end_share of a plant; empty: that of the cell"
    )
    # assumed: holder and spindle nose, which the beam leaves out, and the section of the flutes
    tool_compliance: float = parameter(
        0.2, low=0.0, high=1.0, text="relative standard deviation of the compliances of base and tool of the cell"
    )
    damping_ratio: float = parameter(
        0.3, low=0.0, high=1.0, text="relative standard deviation of the damping ratio of all modes"
    )
    frequency: float = parameter(
        0.1, low=0.0, high=1.0, text="relative standard deviation of the frequencies of all modes, by the moving masses"
    )
    reference_inertia: float = parameter(
        1.0,
        low=0.0,
        high=1.0,
        text="share of the plants whose reference moves the motor side, as every real arm's does",
    )
    # ISO 9283, 0.06 mm: data sheet of the KR 270; noise: a laser tracker at some metres; backlash: none to
    # twice that of the arm
    repeatability: float = parameter(60e-6, unit="um", low=0.0, high=1e4, text="largest repeatability of a plant")
    pose_noise: float = parameter(10e-6, unit="um", low=0.0, high=1e4, text="largest noise of a measured position")
    backlash: float = parameter(
        2.0, low=0.0, high=1000.0, text="largest backlash of a plant, a multiple of arm.backlash_arcsec"
    )
    least_backlash: float = parameter(0.0, low=0.0, high=1000.0, text="smallest such multiple; at most backlash")
    # assumed: closed loops of the axes of heavy arms; one cycle of KUKA RSI
    servo_frequency: np.ndarray = parameter(
        [10.0, 40.0],
        unit="hz",
        low=LEAST_SERVO_FREQUENCY,
        high=1000.0,
        text="lowest and highest frequency of a plant's servo lag, see imperfections.servo_frequency_hz; empty: none",
    )
    servo_delay: float = parameter(
        4e-3,
        unit="ms",
        low=0.0,
        high=1000.0,
        text="longest dead time of a plant's servo lag, beyond imperfections.servo_delay_ms",
    )
    # assumed: between the planned motion and slopes from the neighbouring points
    joining: float = parameter(
        1.0, low=0.0, high=1.0, text="how far a plant's controller joins points otherwise, see imperfections.joining"
    )
    placement: float = parameter(
        0.05e-3,
        unit="mm",
        low=0.0,
        high=10.0,
        text="standard deviation of the stock's place along each axis of the workpiece frame",
    )
    matters_above: float = parameter(
        10e-6, unit="um", low=0.0, high=1e4, text="deviations below this do not matter to the part"
    )

    learned_from: tuple[str, ...] = parameter((), text="measured parts, as ``compensate --measured`` writes them")
    learned: np.ndarray = parameter(
        [], low=-10.0, high=10.0, text="mean of the standard normal numbers behind a plant, learned from these parts"
    )
    learned_directions: np.ndarray = parameter(
        [], low=-1.0, high=1.0, text="D of the covariance I - D^T D of these numbers, row after row"
    )

    def check(self) -> None:
        if self.learned_directions.size % max(1, self.learned.size) or not (self.learned.size or not self.learned_from):
            allowed = "empty, or rows with as many numbers as uncertainty.learned, which learned_from belongs to"
            raise ParameterError("learned_directions", self.learned_directions.size, allowed)
        if self.least_backlash > self.backlash:
            raise ParameterError("least_backlash", self.least_backlash, "at most uncertainty.backlash")
        if self.joint_compliances.size not in (0, 6):
            raise ParameterError("joint_compliances", self.joint_compliances.tolist(), "empty or one number a joint")

        for key, span in (("servo_frequency_hz", self.servo_frequency), ("end_share", self.end_share)):
            if span.size not in (0, 2) or np.any(np.diff(span) < 0.0):
                raise ParameterError(key, span.tolist(), "empty, or lowest and highest")

    @property
    def left(self) -> float:
        """Share of an error that compensation leaves, one standard deviation of joints and forces."""
        return math.hypot(self.joint_compliance, self.force_coefficient)

    def of_coefficients(self, count: int, axial: int) -> np.ndarray:
        """Return the standard deviations of the coefficients of the force law, (count,).

        The list may leave out the last ``axial`` coefficients.
        Raises ParameterError.
        """
        stated = self.force_coefficients
        if stated.size not in (0, count - axial, count):
            allowed = f"empty or one number for each of the {count} coefficients of the force law in use"
            raise ParameterError("uncertainty.force_coefficients", stated.tolist(), allowed)
        return np.append(stated, np.full(count - stated.size, self.force_coefficient))
