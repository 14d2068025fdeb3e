"""What is shipped to be started by hand: the script of one pass, and the notebooks as scripts."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

CONFIG = Path(__file__).resolve().parents[3] / "config"


def test_the_script_makes_one_recorded_pass_and_stops_everything(ros_environment, tmp_path):
    pytest.importorskip("rclpy")
    for name in ("recorder", "trajectory_compensator", "milling_cell"):  # as console scripts are on a user's PATH
        script = tmp_path / "bin" / name
        script.parent.mkdir(exist_ok=True)
        script.write_text(f'#!/bin/sh\nexec {sys.executable} -m kr270_milling.live.nodes {name} "$@"\n')
        script.chmod(0o755)
    environment = {**ros_environment, "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    words = [str(CONFIG / "one_pass.sh"), str(CONFIG / "paper.yaml"), str(tmp_path / "pass")]
    ran = subprocess.run(["bash", *words], env=environment, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr[-2000:]
    from kr270_milling import read_recording

    recorded = read_recording(tmp_path / "pass")
    assert 1e6 * recorded.scores.max_deviation == pytest.approx(62.8, abs=0.1)  # Table 2: 63.2


@pytest.mark.parametrize("name", ["explore_paper.py", "explore_part.py"])
def test_the_notebooks_run(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(CONFIG / name))
    assert "<Pass" in capsys.readouterr().out or name == "explore_part.py"
