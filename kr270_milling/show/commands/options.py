"""Options of ``compensate``, ``check``, ``stability`` and ``bench``."""

from __future__ import annotations

from kr270_milling.live.nodes.play_arguments import bounded, grid
from kr270_milling.physics.compensation.methods import BEST, METHODS
from kr270_milling.show.commands.command import CELL, PLANT, Group, command, option

__all__ = ["COMMANDS", "FEWEST_PLANTS", "LOBE_SPEEDS", "PLANTS"]

PLANTS, FEWEST_PLANTS = 32, 8  #: of a verdict
LOBE_SPEEDS = 60
MOTIONS = ("LIN", "SPLINE")

COMMANDS = {
    "compensate": command(
        "compensate.run", "compensate config/test_piece.yaml --out out",
        *CELL,
        *PLANT,
        option(
            "--method",
            "default: the cell's compensation.method; best: compare the methods and run the best",
            choices=(BEST, *METHODS),
        ),
        option("--out DIR", "where everything goes", default="out"),
        option(
            "--krl",
            "motions of the robot programs; may be given twice (default: LIN for the method linear, which corrects "
            "in straight lines, else the cell's program.motion)",
            choices=MOTIONS,
            action="append",
        ),
        Group(None, (
            option(
                "--verdict N",
                f"judge the compensation by N plants (default {PLANTS}) drawn from the cell's uncertainty; by "
                f"fewer, but at least {FEWEST_PLANTS}, where they take more than 5 minutes. Without this option: "
                f"as many as take less than a minute, and none where {FEWEST_PLANTS} take longer",
                bounded(1, 999_999, int),
                nargs="?",
                const=PLANTS,
            ),
            option("--quick", f"a verdict of {FEWEST_PLANTS} plants; a method that is set is compared with none", bool),
            option("--no-verdict", "no verdict: the model itself is what cuts", bool),
        )),
        option(
            "--force",
            "also write the programs after the decision no, marked NOT RELEASED in name and header",
            bool,
        ),
        option("--seed N", "of the verdict's plants", bounded(1, 999_999, int), 1),
    ),
    "check": command(
        "simulate.check", "check config/test_piece.yaml",
        *CELL,
        option("--reference FILE.csv", "check this trajectory, as written by compensate"),
        option("--motion", "default: the cell's program.motion", choices=MOTIONS),
    ),
    "stability": command(
        "stability.run", "stability config/paper.yaml --speeds 4000:12000:100",
        *CELL,
        option(
            "--speeds LOW:HIGH:COUNT",
            f"spindle speeds [rpm] (default: {LOBE_SPEEDS} from half to one and a half times that of the cell)",
            grid(1.0, 2e5, 100_000),
        ),
        option("--no-arm", "leave out the arm: the modes of tool.modes alone", bool),
        option("--along", "instead of lobes: the limit depth of each feature of the path", bool),
        option("--out DIR", "write lobes.csv and the picture lobes.html here"),
        note="keys: path.radial_immersion (share of the diameter) and path.mode (slot, up, down) state the engagement, "
        "tool.modes the vibration of tool and spindle",
    ),
    "bench": command("bench.run", "bench"),
}  # fmt: skip
