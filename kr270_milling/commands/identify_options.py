"""The parts of ``identify`` with their options."""

from __future__ import annotations

from kr270_milling.commands.command import Group, command, option
from kr270_milling.nodes.play_arguments import bounded, numbers, stretch

__all__ = ["IDENTIFY", "POSTURE", "SENSOR_ABC", "SENSOR_ON", "SIX_AXES"]

SIX_AXES = ("x", "y", "z", "rx", "ry", "rz")
QUANTITIES = ("displacement", "velocity", "acceleration")
POSTURE = numbers(6, most=720.0)
SENSOR_ABC = numbers(3, most=720.0)
SENSOR_ON = option("--sensor-on", "a plate under the part: part", default="tool", choices=("tool", "part"))
INCLUDE = option("--out DIR", "write YAML to include and report")

IDENTIFY = {
    "compliance": command(
        "identify.compliance",
        "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml --cell config/test_piece.yaml --out identified",
        "joint compliances from load tests, or the load tests to make",
        option("measurements MEASUREMENTS.csv", "one load test a row, see identification/README.md", nargs="?"),
        option("--arm ARM.yaml", "arm or cell file to start from", required=True),
        option("--cell CELL.yaml", "where the arm is to mill (default: --arm, if it is a cell file)"),
        option("--at A1,...,A6", "posture there [deg]", POSTURE),
        option("--no-gravity", "leave the link weights out", bool),
        option("--robust", "take the weight from tests that contradict the others", bool),
        option("--compensator NAMES", "also fit these of arm.compensator, as stiffness,preload", default=""),
        Group("plan", (
            option("--plan N", "choose the N load tests that tell most about the cell", bounded(1, 1000, int)),
            option("--point X,Y,Z", "of load and reflector, flange frame [mm]", numbers(3, most=5e3)),
            option("--mass-kg", "to hang; 0: none", bounded(0, 5000), 100.0),
            option("--pull-n", "of a horizontal rope; 0: none", bounded(0, 50_000), 800.0),
            option("--noise-um", "of a measured coordinate, 1 sigma", bounded(0.001, 1e5), 20.0),
            option("--postures", "candidates to choose from", bounded(1, 50_000, int), 2000),
            option("--seed", "of the candidates", bounded(0, 2**31, int), 1),
        )),
        option("--out DIR", "write YAML to include and report, or table and KRL of the plan"),
    ),
    "forces": command(
        "identify.forces", "identify forces CUTS.csv --cell config/test_piece.yaml --out identified",
        "force coefficients from mean forces of cuts, or from recordings of a sensor",
        option("cuts CUTS.csv", "one cut a row, with its forces or a recording of them"),
        option("--cell CELL.yaml", "its tool made the cuts"),
        option("--teeth", "of the tool, instead of the cell's", int),
        option("--diameter-mm", "of the tool, instead of the cell's", bounded(0, 1000)),
        option("--rotation", "instead of the cell's", choices=("clockwise", "counterclockwise")),
        option("--law NAME", "for the YAML file, one of cutting.law", default="linear_edge"),
        Group("recordings of a sensor", (
            option("--topic", "of type geometry_msgs/WrenchStamped", default="wrench"),
            option("--spindle-speed-rpm", "instead of the cell's", bounded(0, 1e6)),
            option("--tare START:STOP", "seconds of an idle stretch", stretch(0, 1e6)),
            option("--sensor-abc A,B,C", "sensor in the workpiece [deg]", SENSOR_ABC),
            SENSOR_ON,
            option("--sensor-mass-kg", "that hangs on it, where there is no tare", bounded(0, 5000), 0.0),
        )),
        INCLUDE,
    ),
    "damping": command(
        "identify.damping", "identify damping RECORDING --topic deflection --out identified",
        "frequency and damping of the modes from a ring-down or an impact",
        option("recording RECORDING", "recording, UFF file, or CSV with time_s, any of x y z rx ry rz, force_n"),
        option("--topic", "of a recording", default="deflection"),
        option("--from S", "seconds after the first sample", bounded(0, 1e6), dest="start"),
        option("--to S", "seconds after the first sample", bounded(0, 1e6), dest="stop"),
        option("--band LOW:HIGH", "[Hz] (default: 2:100)", stretch(0.01, 1e5), (2.0, 100.0)),
        option("--modes N", "at most", bounded(1, 20, int), 6),
        option("--quantity", "of the channels", default=QUANTITIES[0], choices=QUANTITIES),
        option("--hammer", "direction of force_n: scales the shapes by the masses", choices=SIX_AXES),
        option("--cell CELL.yaml", "scales the shapes by its compliance, where no hammer was"),
        INCLUDE,
    ),
    "material": command(
        "identify.material", "identify material Al7075-T6",
        "published force coefficients of a material",
        option("name NAME", "of a material; without it all are listed", nargs="?"),
        option("--row", "which, where a material has several", int, 1),
        option("--out DIR", "write YAML to include"),
    ),
}  # fmt: skip
