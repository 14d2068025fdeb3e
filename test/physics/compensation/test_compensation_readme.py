"""The page of the folder: its commands run, with the plant that it shows."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from kr270_milling.cli import main
from kr270_milling.physics.compensation.methods import METHODS

TEXT = (Path(__file__).resolve().parents[3] / "kr270_milling/physics/compensation/README.md").read_text(
    encoding="utf-8"
)
COMMANDS = [
    line.split()[1:] for block in re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL) for line in block.splitlines()
]
QUICK = ["--set", "path.length_mm=30", "--set", "stock.grid_step_um=40", "--set", "exchange.micro_step_deg=3"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "plant.yaml").write_text(re.search(r"```yaml\n(.*?)```", TEXT, re.DOTALL)[1], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("kr270_milling.decide.compensation.LONGEST_PASS", 0.0)  # the verdict has tests of its own


@pytest.mark.parametrize("words", COMMANDS)
def test_the_commands_of_the_page_run_and_help(words, folder, capsys):
    assert main([*words, *QUICK, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    original, kept = found["passes"]
    assert original["name"] == "original" and kept["name"] == found["method"]
    assert {"static_deviation_mm", "max_deviation_mm"} <= set(kept)
    assert kept["max_deviation_mm"] < 0.1 * original["max_deviation_mm"]
    assert found["identified"]["modes"][0]["frequency_hz"] == pytest.approx(
        6.69 * (1.1 if "--plant" in words else 1), rel=0.03
    )


def test_every_method_stands_on_the_page():
    assert all(f"`{name}`" in TEXT for name in METHODS)


def test_a_method_that_makes_the_part_worse_says_so_beside_the_decision(tmp_path, capsys):
    sets = ("dynamics.reference_inertia=true", "dynamics.damping_ratio=0.04", "stock.grid_step_um=40")
    words = [part for pair in sets for part in ("--set", pair)]
    main(["compensate", "paper.yaml", "--method", "spline", "--no-verdict", "--out", str(tmp_path / "out"), *words])
    lines = capsys.readouterr().out.splitlines()[:8]
    assert any(line.startswith("spline makes the part worse than no compensation (12") for line in lines)


def test_noise_that_is_no_number_is_refused(capsys):
    for text in ("nan", "-1", "much"):
        with pytest.raises(SystemExit, match="2"):
            main(["simulate", "paper.yaml", "--noise-um", text])
        assert "--noise-um" in capsys.readouterr().err
